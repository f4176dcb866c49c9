"""Where to start from, and which motions to try next.

In: a `PlanningProblem`. Out: initial guesses (smooth paths, the phase plane, swings, perturbed guesses), continuation from
    one
motion to the next, and the plans they lead to.
"""
