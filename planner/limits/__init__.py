"""The limits at every instant of a motion, one kind per file: rows and bounds, margin, relaxation, sentence.

In: a problem, units, samples of a motion. Out: the limits of a problem and their margins. The program, the certificate, the
constraint tightening and the diagnosis loop over them.
"""
