"""A first problem file, with a feasible motion of a mechanism.

In: a mechanism's model. Out: a problem's tables, its plan, and the text of the file with comments.
"""
