"""`linkplan check`: what a mechanism is and how far it reaches, before any plan.

In: a mechanism, or a problem. Out: findings and a report along its reach, as text, record and figure.
"""
