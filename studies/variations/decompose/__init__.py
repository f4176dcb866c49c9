"""`linkplan decompose`: the causes of each tracker's error, found by switching causes on one after another.

In: a plan, trackers, imperfections. Out: signed parts that add up to each tracker's rms error, a table, a figure.
"""
