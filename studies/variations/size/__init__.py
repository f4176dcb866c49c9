"""`linkplan size`: which motors of a list, behind which gears, can drive a problem's motion, and with what margins.

In: a problem, an actuator, a list of motors. Out: a plan for each motor and gear, its loads, a table with the best first.
"""
