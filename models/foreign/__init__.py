"""Model files of other simulators and formats: what MuJoCo's reader drops, refuses or misreads is read or repaired here.

In: the text of an MJCF or URDF file, exporters' files of loops. Out: elements of a MuJoCo specification (loops, drives,
joints), and notes on what was repaired or deleted.
"""
