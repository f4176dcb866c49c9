"""Proofs that a motion satisfies its limits at every instant, in ball arithmetic.

In: a problem and the coefficients of a trajectory.
Out: a `Proof`: claims on the whole motion, each of them proved, refuted, undecided or sampled (checked at samples only).
"""
