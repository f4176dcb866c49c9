"""`linkplan decompose`: where each tracker's error comes from, split among causes that are switched on one after another.

In: a plan, trackers, imperfections. Out: signed parts of each tracker's rms error that add up to it, a table, a figure.
"""
