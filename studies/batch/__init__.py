"""`linkplan batch`: many problems that vary one, planned on an engine, taken up where a process was killed.

In: a batch file's problem and cases. Out: a plan's folder for each case that has one, the record of all of them, a table.
"""
