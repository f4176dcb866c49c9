"""The planning problem, built from the sections of a problem file and checked when it is built.

In: tables, as files, builders and saved plans make them; `keys` has each key's type, range, default and meaning. Out: a
`Problem`: mechanism, motion, objective, limits, settings.
"""
