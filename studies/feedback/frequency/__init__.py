"""Feedback loops in the frequency domain: prediction, measurement, and behaviour beyond the effort limits.

In: a mechanism, an operating point and a tracker. Out: sampled-data loop models, margins, frequency responses measured in
MuJoCo, stability borders, describing functions and Floquet multipliers.
"""
