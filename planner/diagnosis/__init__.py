"""Why there is no motion; never a motion.

In: a `PlanningProblem` that the search did not solve. Out: the limit that forbids it, with joint, instant and amount, and
the least limit or shortest duration that would do.
"""
