"""The planning problem, built from the sections of a problem file and checked when it is built.

In: tables, as files, builders and saved plans make them. Out: a `Problem`: mechanism, motion, objective, limits, settings.
"""
