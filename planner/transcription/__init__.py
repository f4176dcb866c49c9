"""Direct collocation of any continuous problem, independent of mechanisms and files.

In: a `Formulation` (functions at a node, bounds, units) and a `Mesh` with a `Scheme`. Out: a `Transcribed` nonlinear
program with its numbers, and its unknowns read back as piecewise polynomials.
"""
