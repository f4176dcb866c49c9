"""Certificates: checks of a motion between the nodes, where the solver imposes nothing.

In: a `Problem` and a `Trajectory`. Out: a `Certificate`: limits on a dense grid, closure gap, dynamics residual,
the state reached by integrating the reduced model, and contacts along the motion.
"""
