"""The phase plane: least-time motions of one degree of freedom.

In: a `Problem` of one degree of freedom. Out: motions of least time that satisfy its limits on effort, power, speed and
pin force. They serve as initial guesses, as plans and as bounds.
"""
