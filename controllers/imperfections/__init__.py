"""What a real feedback loop has and a model has not: clocks, sensors, drives, friction, wrong masses and lengths, pushes.

In: small frozen values. Out: the simulated machine that they make of a mechanism, and its sensors and drives as arrays.
"""
