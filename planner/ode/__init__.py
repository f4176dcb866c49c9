"""A user's ordinary differential equation as a client of transcription and refinement.

In: an `OdeProblem`. Out: an `OdePlan` with trajectory and certificate, from `plan_ode`.
"""
