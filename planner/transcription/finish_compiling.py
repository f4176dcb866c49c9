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

from linkplan.planner.transcription.cache import evict, keep

# Added to the priority number: the planner goes first.
_NICER = 10


def main(folder: Path, work: Path, key: str, timeout_s: float, command: list[str]) -> int:
    """Compile in WORK and keep the library in FOLDER; 1 where that fails."""
    nothing = subprocess.DEVNULL
    try:
        if hasattr(os, "nice"):
            os.nice(_NICER)
        with subprocess.Popen(
            command, cwd=work, stdin=nothing, stdout=nothing, stderr=nothing, start_new_session=True
        ) as compiler:
            try:
                code = compiler.wait(timeout_s)
            except BaseException:
                with contextlib.suppress(OSError):
                    os.killpg(compiler.pid, signal.SIGKILL)
                raise
        if code == 0:
            keep(work / f"{key}.so", json.loads((work / f"{key}.said").read_text(encoding="utf-8")), folder, key)
            evict(folder, key)
        return int(code != 0)
    except (OSError, ValueError, subprocess.SubprocessError):
        return 1
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], float(sys.argv[4]), sys.argv[5:]))
