"""Mechanisms as a client of transcription and refinement.

In: a `PlanningProblem`, a guess and a mesh. Out: its `Formulation` with reduced dynamics and lifted dependent coordinates,
a solution as a `Trajectory`, and motions that are prescribed, by inverse dynamics alone.
"""
