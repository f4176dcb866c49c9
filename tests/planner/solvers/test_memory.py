"""The memory that the solver's linear algebra needs: without it a command ends instead of waiting for ever."""

import subprocess
import sys

import pytest

from linkplan.planner.solvers import solve


def test_a_solver_without_memory_for_its_linear_algebra_is_refused(monkeypatch):
    monkeypatch.setattr(solve, "_OPENBLAS_BUFFER_BYTES", 1 << 60)
    with pytest.raises(MemoryError, match="MB more memory"):
        solve._hold_linear_algebra_buffer.__wrapped__()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits on address space are those of Linux")
def test_a_plan_in_little_memory_ends_in_one_line():
    """OpenBLAS asked for its buffer for ever at 380,000 to 450,000 kB, and ignored every signal."""
    command = f"ulimit -v 400000; exec {sys.executable} -m linkplan plan knee-reach"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("linkplan plan: not enough memory"), done.stderr
    assert "Traceback" not in done.stderr
