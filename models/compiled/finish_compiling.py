"""A separate process that compiles the functions written by a planner and puts the library into the cache.

    python -m linkplan.models.compiled.finish_compiling FOLDER WORK KEY TIMEOUT_S COMMAND...

The process loads neither CasADi nor numpy, has a low priority, and removes WORK at its end.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

from linkplan.models.compiled.cache import evict, keep_entry


def run_with_children(command: list[str], work: Path | None, timeout_s: float) -> None:
    """Run a program in a folder; kill it with its children when it exceeds the timeout or is interrupted.

    Raises:
        OSError: when it cannot be started.
        subprocess.SubprocessError: when it fails or exceeds the timeout.
    """
    nothing = subprocess.DEVNULL
    with subprocess.Popen(
        command, cwd=work, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
    ) as process:
        try:
            code = process.wait(timeout_s)
        except BaseException:
            with contextlib.suppress(OSError):
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()
            raise
    if code:
        raise subprocess.CalledProcessError(code, command)


def main(folder: Path, work: Path, key: str, timeout_s: float, command: list[str]) -> int:
    """Compile in WORK and keep the library in FOLDER; return 1 on failure."""
    try:
        if hasattr(os, "nice"):
            os.nice(10)  # the planner has priority
        run_with_children(command, work, timeout_s)
        keep_entry(work / f"{key}.so", json.loads((work / f"{key}.record").read_text(encoding="utf-8")), folder, key)
        evict(folder, key)
        return 0
    except (OSError, ValueError, subprocess.SubprocessError):
        return 1
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], float(sys.argv[4]), sys.argv[5:]))
