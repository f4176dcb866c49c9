"""The search for a motion.

In: a `PlanningProblem`. Out: initial guesses (smooth paths, the phase plane, swings, perturbed guesses), continuation from
one motion to the next, and the plans to which they lead.
"""
