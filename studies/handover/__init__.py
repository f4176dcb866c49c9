"""What other programs take over: plans, control laws and models as files, serial equivalents of linkages.

In: a plan or a mechanism. Out: files for simulators, controllers and microcontrollers, with their errors and costs.
"""
