"""The part of `make bench` on exported C code: inverse dynamics beside CasADi's own function and MuJoCo's mj_inverse.

All compute from the same closed poses, velocities and accelerations, state after state. The C code and CasADi's function get
the pose closed; a row of its own closes the loops from a pose beside. mj_inverse gets the accelerations of all joints, and
its time includes what Python needs to hand over a state, about a microsecond.
"""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import accelerations, sampled
from linkplan.studies.handover.export.c_files import write_model
from linkplan.studies.handover.export.c_model import model_code, random_states
from linkplan.studies.output.text import table
from tests.bench.timing import medians_s, say
from tests.support import parallel_ankle

STATES = 2000
_DRIVER = """
#include "{p}.h"
void inverse(int n, const double *q, const double *v, const double *a, double *effort)
{{
  int k;
  for (k = 0; k < n; ++k) {p}_inverse_dynamics(q + k * {n_q}, v + k * {n_s}, a + k * {n_s}, effort + k * {n_s});
}}
void close_all(int n, const double *s, double *q)
{{
  int k;
  for (k = 0; k < n; ++k) {p}_close(s + k * {n_s}, q + k * {n_q});
}}
"""


def bench_c() -> str:
    """Return microseconds of a call of exported C code, over those of CasADi's function and of mj_inverse."""
    if shutil.which("gcc") is None:
        return "C code is not measured: there is no gcc"
    mechanisms = {
        "optimus-knee": load_mechanism("optimus-knee"),
        "five-bar": load_mechanism("five-bar"),
        "parallel ankle": load_mechanism(parallel_ankle.ankle_text()),
    }
    rows = []
    for name, mechanism in mechanisms.items():
        say(f"C code of {name}")
        each, off = measured(mechanism)
        ours = each["C"]
        ratios = [ours / each[one] for one in ("CasADi", "CasADi in C", "mj_inverse")]
        rows.append([name, ours, each["close"], *ratios, off])
    heads = ["inverse dynamics", "C [us]", "closing loops in C [us]", "C over CasADi's interpreter",
             "over CasADi's own C", "over mj_inverse", "C minus CasADi, share of largest"]  # fmt: skip
    return table(heads, rows)


def measured(mechanism: Mechanism) -> tuple[dict[str, float], float]:
    """Return the microseconds of each, and the largest difference of C to CasADi as a share of the largest effort."""
    states = random_states(mechanism, STATES, seed=3)
    q, v, a = (np.ascontiguousarray(states[name]) for name in ("q", "v", "a"))
    function = mechanism.dynamics.inverse_dynamics
    own = function.map(STATES)
    with tempfile.TemporaryDirectory() as folder:
        ours = _library(mechanism, Path(folder))
        theirs = _casadi_library(function, Path(folder))
        found, near = np.empty_like(v), q.copy()
        s = np.ascontiguousarray(q[:, mechanism.independent])
        works = {
            "C": lambda: ours.inverse(STATES, *[x.ctypes.data_as(ctypes.c_void_p) for x in (q, v, a, found)]),
            "close": lambda: ours.close_all(STATES, *[x.ctypes.data_as(ctypes.c_void_p) for x in (s, near)]),
            "CasADi": lambda: own(q.T, v.T, a.T),
            "CasADi in C": lambda: theirs(q.T, v.T, a.T),
            "mj_inverse": _in_mujoco(mechanism, q, v, a),
        }
        each = {name: 1e6 * taken / STATES for name, taken in medians_s(works).items()}
    wanted = np.array(own(q.T, v.T, a.T)).T
    return each, float(np.abs(found - wanted).max() / np.abs(wanted).max())


def _library(mechanism: Mechanism, folder: Path) -> ctypes.CDLL:
    code = model_code(mechanism)
    write_model(code, folder, compiled=False)
    text = _DRIVER.format(p=code.prefix, n_q=mechanism.n_q, n_s=mechanism.dof)
    (folder / "driver.c").write_text(text)
    return _built(folder, "ours.so", ["driver.c", f"{code.prefix}.c"])


def _casadi_library(function: ca.Function, folder: Path) -> ca.Function:
    """Return a function as CasADi's own C code, compiled, over all states."""
    generator = ca.CodeGenerator("own.c")
    generator.add(function)
    generator.generate(f"{folder}/")
    _built(folder, "own.so", ["own.c"])
    return ca.external(function.name(), str(folder / "own.so")).map(STATES)


def _built(folder: Path, name: str, sources: list[str]) -> ctypes.CDLL:
    subprocess.run(["gcc", "-O2", "-shared", "-fPIC", *sources, "-lm", "-o", name], check=True, cwd=folder)
    return ctypes.CDLL(str(folder / name))


def _in_mujoco(mechanism: Mechanism, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> Callable[[], None]:
    """Return a function that runs mj_inverse at every state of hinges and slides."""
    model = mechanism.model
    data = mujoco.MjData(model)
    qpos = mechanism.qpos_of(q)
    rates = np.einsum("nqs,ns->nq", sampled(mechanism.dynamics.velocity_map, q), v)
    qacc = accelerations(mechanism, q, v, a)

    def run() -> None:
        for pose, rate, acceleration in zip(qpos, mechanism.qvel_of(q, rates), qacc, strict=True):
            data.qpos[:], data.qvel[:], data.qacc[:] = pose, rate, acceleration
            mujoco.mj_inverse(model, data)

    return run
