"""Feedback loops: their frequency responses and margins, and gains that reach a bandwidth.

In: a problem or model, a tracker, requirements. Out: what `linkplan bode` and `linkplan tune` answer.
"""
