"""The command line: parse arguments, run a study, print and write its result, return an exit code."""
