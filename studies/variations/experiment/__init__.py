"""`linkplan experiment`: several trackers of one plan on the same set of imperfect machines.

In: a plan, trackers and distributions of imperfections. Out: metrics of every run in a columnar file, paired comparisons
with confidence intervals, figures, and the replay of any sample.
"""
