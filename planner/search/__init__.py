"""The search for a motion.

In: a `Problem`. Out: initial guesses (smooth paths, the phase plane, swings, perturbed guesses), continuation from
one motion to the next, and the plans to which they lead.
"""
