"""IPOPT behind one call.

In: a `Transcribed` program and `SolverSettings`. Out: a `Solution`: unknowns, multipliers, status, iterations and times.
"""
