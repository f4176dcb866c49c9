"""The planning problem, built from the sections of a problem file and checked when it is built.

In: tables from files, builders and saved plans; `keys` has each key's type, range, default and meaning. Out: a
`Problem`: mechanism, motion, objective, limits, settings.
"""
