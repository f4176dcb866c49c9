"""Actuators and their transmissions: effort limits and the effort's action on the coordinates.

In: a model's actuators and their transmissions. Out: effort limits and moment arms as expressions of q.
"""
