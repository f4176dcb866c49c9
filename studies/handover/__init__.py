"""Results for other programs: plans, control laws and models as files, and serial equivalents of linkages.

In: a plan or a mechanism. Out: files for simulators, controllers and microcontrollers, with their errors and costs.
"""
