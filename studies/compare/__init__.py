"""`linkplan track` and `compare`: trackers side by side on one plan.

In: a plan and trackers. Out: runs in MuJoCo, nominal and with a mismatch, their metrics and figures.
"""
