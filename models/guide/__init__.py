"""A site guided along a curve: curves, and mechanisms whose only freedom is the way along one.

In: a `Mechanism`, a site, and points of a path. Out: a curve with continuous second derivatives; a mechanism whose only
coordinate is the curve's parameter, with all equations of motion of the free one.
"""
