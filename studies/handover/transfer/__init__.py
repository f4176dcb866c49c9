"""Transfer tables between motors and output joints of a linkage, as tables, figures and files.

In: a mechanism, its output joints, and gains or speeds to convert. Out: `Transfer`, as a document, columns with units, and
files for simulators and controllers that support only trees.
"""
