"""Optimal control of a user's ordinary differential equation, by transcription and refinement.

In: an `OdeProblem`. Out: an `OdePlan` with trajectory and certificate, from `plan_ode`.
"""
