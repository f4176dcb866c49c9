"""Run a command and print, as JSON, the processor time of it and of all that it starts, its stdout, stderr and exit code.

    python tests/bench/counted.py PATIENCE_S COMMAND...

The exit code is null where PATIENCE_S [s] of wall time passed.
"""

import json
import resource
import subprocess
import sys


def main(patience_s: float, command: list[str]) -> None:
    """Run, and print what it took and said."""
    try:
        ran = subprocess.run(command, capture_output=True, text=True, check=False, timeout=patience_s)
        said = {"code": ran.returncode, "stdout": ran.stdout, "stderr": ran.stderr}
    except subprocess.TimeoutExpired:
        said = {"code": None, "stdout": "", "stderr": ""}
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(json.dumps({"processor_s": spent.ru_utime + spent.ru_stime} | said))


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2:])
