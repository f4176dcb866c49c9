"""`linkplan track` and `compare`: trackers side by side on one plan.

In: a plan and trackers. Out: runs in MuJoCo with the modelled and with a changed mechanism, metrics and figures.
"""
