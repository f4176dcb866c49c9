"""Exit codes of the command line."""

from enum import IntEnum


class ExitCode(IntEnum):
    """The exit codes of commands that no signal ended."""

    DONE = 0
    ANSWER_IS_NO = 1  # infeasible, unstable, problems found: with a sentence
    BAD_INPUT = 2
    BROKEN_PIPE = 141  # stdout was closed before the result was written: the code that a shell shows for SIGPIPE


class NoMotionError(Exception):
    """A command needs a plan with a motion, and `plan` has none; the plan's message is the reason."""

    def __init__(self, plan) -> None:
        super().__init__(plan.message)
        self.plan = plan


DONE, NO, BAD_INPUT = ExitCode.DONE, ExitCode.ANSWER_IS_NO, ExitCode.BAD_INPUT
# A command that a signal ended has the sum of this and the signal's number: 130 for Ctrl-C, 143 for SIGTERM.
SIGNAL_BASE = 128
