"""Maps between motors and output joints across a linkage, and the model without loops that has the same outputs.

In: a `Mechanism` and the names of its output joints. Out: transmission, reflected inertia and losses at poses; tables of
them on an adaptive grid; polytopes of efforts and gains.
"""
