"""`linkplan track` and `compare`: runs of trackers on one plan, compared.

In: a plan and trackers. Out: runs in MuJoCo with the modelled and with a changed mechanism, metrics and figures.
"""
