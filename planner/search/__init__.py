"""The search for a motion, and the reason where there is none.

In: a `Problem`. Out: initial guesses (smooth paths, the phase plane, swings, perturbed guesses) and the plans to which they
lead: of one problem, of a changed one, of many. Without a motion, a diagnosis: the limit that forbids one, with joint, time
and amount, and the least limit or shortest duration that would be enough.
"""
