"""CasADi's functions compiled by the machine's C compiler, kept in a cache of this user by a hash of what they compute.

In: a dataclass of CasADi functions, a key. Out: the same with compiled functions; interpreted where there is no compiler.
"""
