"""Exit codes of the command line."""

# Done; the answer is no (infeasible, unstable, problems found), said in a sentence; bad input, one line; interrupted.
DONE, NO, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
