"""Poses of an assembled mechanism, and what is found at them.

In: a `Mechanism` and independent positions. Out: closed poses along paths and as far as they reach, sampled dynamic
quantities, equilibria on springs, contacts between geoms, and a stick drawing.
"""
