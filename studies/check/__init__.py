"""`linkplan check` and `linkplan new`: the properties of a mechanism and its reach, and a first motion.

In: a mechanism, or a problem. Out: findings and properties over the reach, as text, record and figure; a first problem file.
"""
