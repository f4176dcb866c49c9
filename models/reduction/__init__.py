"""Reduced dynamics by coordinate partitioning.

In: tree dynamics, closure equations and the choice of independent coordinates. Out: functions of (q, v, u) for the velocity
map Gamma, reduced inertia, inverse dynamics, closure forces and the singularity measure det J_z; closed poses by
continuation, as expressions and in numbers.
"""
