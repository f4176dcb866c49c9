"""A process of its own that compiles what a planner wrote, and puts it into the cache.

    python -m linkplan.planner.transcription.finish_compiling FOLDER WORK KEY TIMEOUT_S COMMAND...

It loads neither CasADi nor numpy, is nicer than the planner, and holds the lock of WORK, which it removes at its end.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

from linkplan.planner.transcription.cache import evict, keep

# Added to the priority number: the planner goes first.
_NICER = 10


def run_with_children(command: list[str], work: Path | None, timeout_s: float, said: IO[bytes] | None = None) -> None:
    """Run a program in a folder; where it hangs or is interrupted, its children end with it.

    Raises:
        OSError: where it cannot be started.
        subprocess.SubprocessError: where it fails, or takes too long.
    """
    nothing = subprocess.DEVNULL
    with subprocess.Popen(
        command, cwd=work, stdin=nothing, stdout=said or nothing, stderr=nothing, start_new_session=True
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
    """Compile in WORK and keep the library in FOLDER; 1 where that fails."""
    try:
        if hasattr(os, "nice"):
            os.nice(_NICER)
        run_with_children(command, work, timeout_s)
        keep(work / f"{key}.so", json.loads((work / f"{key}.said").read_text(encoding="utf-8")), folder, key)
        evict(folder, key)
        return 0
    except (OSError, ValueError, subprocess.SubprocessError):
        return 1
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], float(sys.argv[4]), sys.argv[5:]))
