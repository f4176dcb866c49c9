"""Values that users give, as the tables of a problem file have them: numpy's numbers and arrays, tuples, paths."""

from linkplan.planner.problem.values import plain

__all__ = ["plain"]
