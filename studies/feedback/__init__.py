"""Feedback loops: their frequency responses and margins, and gains that reach a bandwidth.

In: a problem or model, a tracker, requirements. Out: the results of `linkplan bode` and `linkplan tune`.
"""
