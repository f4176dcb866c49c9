"""Imperfections of real feedback loops: clocks, sensors, drives, friction, errors of mass and length, pushes.

In: small frozen values. Out: a mechanism's model with these imperfections, and its sensors and drives as arrays.
"""
