"""Actuators: what an effort does to the coordinates.

In: a model's actuators and their transmissions. Out: effort limits and moment arms as expressions of q.
"""
