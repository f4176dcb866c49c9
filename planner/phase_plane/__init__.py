"""The phase plane: the exact answer for one degree of freedom.

In: a `Problem` of one degree of freedom. Out: motions of least time within its limits on effort, power and pin
force. They are guesses for a solver, motions of their own, and bounds.
"""
