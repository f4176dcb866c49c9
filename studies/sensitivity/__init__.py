"""Which of several factors a number owes most to: where to try them, and what the answers say. It knows numbers alone.

In: how many factors, how many trials, a figure for each trial. Out: trials in the unit cube, and each factor's influence
with its 95 % interval.
"""
