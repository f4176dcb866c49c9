"""The continuous planning problem, checked when it is built.

In: a mechanism, a motion, an objective, limits, a reference and settings. Out: a `PlanningProblem`.
"""
