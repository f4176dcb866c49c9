"""Exit codes of the command line."""

# Done; the answer is no (infeasible, unstable, problems found), said in a sentence; bad input, one line.
DONE, NO, BAD_INPUT = 0, 1, 2
# The reader of stdout left before the result: what the shell says of programs that a broken pipe ends.
NOBODY_READS = 141
# Ended by a signal: this and its number, 130 for Ctrl-C and 143 for SIGTERM.
BY_SIGNAL = 128
