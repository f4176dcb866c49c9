"""`linkplan size`: which motor of a list, behind which gear, does a problem's motion, and by what margin.

In: a problem, an actuator, a list of motors. Out: a plan for each motor and gear, its loads, a table with the best first.
"""
