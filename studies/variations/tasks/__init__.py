"""Many tasks on one engine: this process, a pool of processes or a cluster. Results are saved as they arrive.

In: an engine, a function and the numbers of its tasks. Out: each result once, as soon as it is available; and a folder of
parts, from which the same command continues after an interruption.
"""
