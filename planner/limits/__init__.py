"""The limits on every instant of a motion, one file a kind: rows and bounds, margin, relaxation, sentence.

In: a problem, units, samples of a motion. Out: `limits_of` a problem, which the program, the certificate, the tightening of
constraints and the diagnosis loop over; `Margin`s.
"""
