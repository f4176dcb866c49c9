"""Sensitivity analysis of a number to several factors, independent of any application.

In: the number of factors and of trials, and a figure for each trial. Out: trials in the unit cube, and each factor's
influence with its 95 % interval.
"""
