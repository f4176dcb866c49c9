"""A problem file to begin with: a motion that a mechanism surely can make, and every option in comments.

In: a mechanism's model. Out: a problem's tables, planned, and its commented text.
"""
