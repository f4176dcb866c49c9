"""Poses of an assembled mechanism, and quantities at these poses.

In: a `Mechanism` and independent positions. Out: closed poses along paths, the reach of each joint, sampled dynamic
quantities, equilibria on springs, contacts between geoms, and a stick drawing.
"""
