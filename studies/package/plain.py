"""Conversion of users' values, such as numpy arrays, tuples and paths, to the types of a problem file's tables."""

from linkplan.planner.problem.values import plain

__all__ = ["plain"]
