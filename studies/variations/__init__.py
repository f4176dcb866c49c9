"""Many problems and many machines: experiments, their causes and sensitivities, batches of problems.

In: a problem or plan, and what varies. Out: the results of all variations, compared; an interrupted study continues.
"""
