"""Symbolic kinematics and dynamics of the kinematic tree of a compiled MuJoCo model.

In: a compiled `mjModel`. Out: internal coordinates q for its hinges, slides and ball joints, and CasADi expressions of
M(q), h(q, v), passive forces and tendon lengths that agree with MuJoCo's to rounding.
"""
