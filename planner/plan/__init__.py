"""The answer to a planning problem, and its folder.

In: a problem, a trajectory, a certificate; or a saved folder. Out: `Plan`: status, message, motion at any times in users'
units; the folder written, and read back with a new certificate.
"""
