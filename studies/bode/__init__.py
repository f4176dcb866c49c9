"""`linkplan bode`: a loop over angles, along a motion, and over its gains.

In: a problem or model and a tracker. Out: responses and margins at every angle, stability maps, tables and figures.
"""
