"""From a first solution to one whose certificate passes.

In: a `Case` (what is transcribed and certified) and a first solution. Out: the motion on a refined mesh: phase boundaries at
its switch times and constrained arcs, finer or higher-degree intervals, tightened limits.
"""
