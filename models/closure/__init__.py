"""Loop closure: from a model's equality constraints to phi(q) = 0 and a pose that satisfies it.

In: the tree's coordinates and the model's connects, welds, couplings and fixed tendons. Out: closure equations, their rank
with independent rows and dependent columns, the initial assembly, and the freedoms that nothing steers.
"""
