"""`linkplan experiment`: the trackers of one plan on many imperfect machines, the same machines for each.

In: a plan, trackers, imperfections and where they lie. Out: metrics of every run in a columnar file, paired comparisons with
confidence intervals, figures, and any sample run again.
"""
