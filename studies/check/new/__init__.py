"""A first problem file: a motion that a mechanism can make.

In: a mechanism's model. Out: a problem's tables, its plan, and the text of the file with comments.
"""
