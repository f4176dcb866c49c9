"""Many tasks on one engine: this process, a pool of processes or a cluster, their results kept as they come.

In: an engine, a function and the numbers of its tasks. Out: each result once, as soon as it is there; and a folder of parts
from which the same command goes on after whatever ended it.
"""
