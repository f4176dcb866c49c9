"""Loop closure: a model's equality constraints as equations phi(q) = 0, and poses that satisfy them.

In: the tree's coordinates and the model's connects, welds, couplings and fixed tendons. Out: closure equations, their rank
with independent rows and dependent columns, the initial assembly, and the passive degrees of freedom.
"""
