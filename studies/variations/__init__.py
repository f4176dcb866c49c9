"""Studies of many machines or many problems: experiments, causes and sensitivities of errors, batches of problems.

In: a problem or plan, and what varies. Out: the results of all variations, compared; an interrupted study continues.
"""
