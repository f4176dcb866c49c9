"""`linkplan check`: the properties of a mechanism and its reach, before any plan.

In: a mechanism, or a problem. Out: findings and a report along its reach, as text, record and figure.
"""
