"""How many answers depend on rounding: `python -m tests.bench rounding`, or `make bench rounding EVERY=5`.

Part of the record of answers is made with two kernels of OpenBLAS, and again with every number of the problems changed by
1e-12 of it. Statuses are to be equal and objectives within a millionth. Every EVERYth problem of a group is planned, by
default every 15th in some ten minutes.
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from tests.bench.record import EQUAL, differences, load_record

# Kernels of x86-64 processors, the widest first, and the groups of the record whose problems are tables.
KERNELS = ("SkylakeX", "Haswell", "Sandybridge", "Prescott")
GROUPS = ("builtin", "fourbar", "slider", "turning")
CHANGE = 1e-12


def kernels() -> list[str]:
    """Return the first two of OpenBLAS' kernels that this processor has; fewer where it has fewer."""
    found = []
    for name in KERNELS:
        environment = os.environ | {"OPENBLAS_CORETYPE": name, "OPENBLAS_VERBOSE": "2"}
        said = subprocess.run(
            [sys.executable, "-c", "import numpy"], env=environment, capture_output=True, text=True, check=True
        )
        if name.lower() in (said.stdout + said.stderr).lower():
            found.append(name)
    return found[:2]


def answers(folder: Path, name: str, kernel: str, change: float, every: int) -> dict[tuple[str, str], dict]:
    """Return part of the record of answers, planned by another process with a kernel and changed numbers."""
    command = [sys.executable, "-m", "tests.bench.record", str(folder / name), "--groups", *GROUPS, "--every", str(every)]
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel}
    subprocess.run([*command, "--processes", "1", "--changed", repr(change)], env=environment, check=True)
    return load_record(folder / name)


def unlike(before: Mapping, now: Mapping) -> list[str]:
    """Return the sentences on answers whose status, or objective by more than a millionth, is another."""
    return [f"{key[0]} {key[1]}: {line}" for key in before for line in differences(before[key], now[key])]


def bench_rounding(every: int = int(os.environ.get("EVERY", "15"))) -> str:
    """Return how many answers differ between two kernels, and where numbers are changed by 1e-12 of them."""
    have = kernels()
    if len(have) < 2:
        return f"OpenBLAS has one kernel here, {' '.join(have) or 'none that can be chosen'}: nothing to compare"
    first, second = have
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        base = answers(place, "first", first, 0.0, every)
        others = {
            f"kernel {second} for {first}": answers(place, "second", second, 0.0, every),
            f"numbers changed by {CHANGE:g}": answers(place, "changed", first, CHANGE, every),
        }
    text = [f"answers that depend on rounding (statuses equal, objectives to {EQUAL:g}), of {len(base)}"]
    for what, other in others.items():
        found = unlike(base, other)
        text += [f"{what}: {len({line.split(':')[0] for line in found})} differ", *(f"  {line}" for line in found)]
    return "\n".join(text)
