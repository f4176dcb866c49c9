"""Direct collocation, for any system: knows neither mechanisms nor files.

In: a `Formulation` (functions at a node, bounds, units) and a `Mesh` with a `Scheme`. Out: a `Transcribed` nonlinear
program with its numbers, and its unknowns read back as piecewise polynomials.
"""
