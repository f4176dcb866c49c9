"""Reduced dynamics by coordinate partitioning.

In: tree dynamics, closure equations, and which coordinates are independent. Out: functions of (q, v, u): the velocity map
Gamma, reduced inertia, inverse dynamics, closure forces, and the singularity measure det J_z.
"""
