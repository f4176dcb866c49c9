"""`linkplan bode`: a feedback loop at several poses, along a motion, and for ranges of gains; or a plant without its loop.

In: a problem or model and a tracker. Out: responses and margins at every pose, stability maps, tables and figures.
"""
