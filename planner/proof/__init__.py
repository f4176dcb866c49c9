"""Proofs that a motion keeps its limits at every instant, in ball arithmetic.

In: a problem and the coefficients of a trajectory.
Out: `Proof`: claims on the whole motion, each proved, refuted or undecided, and what is checked at samples only.
"""
