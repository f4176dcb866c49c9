"""Solving a transcribed program with IPOPT, and Newton steps between similar programs.

In: a `Transcribed` program and `SolverSettings`. Out: a `Solution`: unknowns, multipliers, status, iterations and times.
"""
