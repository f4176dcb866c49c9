"""Tracking of motions in phases on the ground.

In: a mechanism, its feet, a law for each phase. Out: the machine with real contacts, one law for all phases, and the maps of
errors through impacts.
"""
