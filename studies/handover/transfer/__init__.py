"""Transfer tables: what motors and output joints are to each other across a linkage, as tables, figures and files.

In: a mechanism, its output joints, and gains or speeds to carry across. Out: `Transfer`, as a document, columns with units,
and files for simulators and controllers that know trees only.
"""
