"""Diagnoses of problems without a motion.

In: a `Problem` that the search did not solve. Out: the limit that forbids a motion, with joint, time and amount, and
the least limit or shortest duration that would be feasible. No diagnosis returns a motion.
"""
