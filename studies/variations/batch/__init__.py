"""`linkplan batch`: variants of one problem, planned on an engine; an interrupted batch can be resumed.

In: a batch file's problem and cases. Out: a folder for each feasible plan, a record of all cases, and a table.
"""
