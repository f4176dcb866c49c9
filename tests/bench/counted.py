"""Run a command and print, as JSON, the processor time of it and of all that it starts, its stdout, stderr and exit code.

    python tests/bench/counted.py PATIENCE_S COMMAND...

A compiler in the background outlives the command. On Linux it becomes this process's child, is waited for and counted;
elsewhere only what the command itself has waited for is. The exit code is null where PATIENCE_S [s] of wall time passed.
"""

import contextlib
import ctypes
import json
import os
import resource
import subprocess
import sys

# Of linux/prctl.h: orphans among the descendants become children of this process.
_SET_CHILD_SUBREAPER = 36


def main(patience_s: float, command: list[str]) -> None:
    """Run, wait for all descendants, and print what they took and said."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    try:
        ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=patience_s)
        said = {"code": ran.returncode, "stdout": ran.stdout, "stderr": ran.stderr}
    except subprocess.TimeoutExpired:
        said = {"code": None, "stdout": "", "stderr": ""}
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(json.dumps({"processor_s": spent.ru_utime + spent.ru_stime} | said))


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2:])
