"""A plan's control law as C99: reference, feedforward and gains as tables over the control instants, effort = law(t, s, v).

Every law here is u = u_ff[k] + K[k] (x_ref[k] - x) with x = (s, v): PD and PD with feedforward, gain-scheduled PD, LQR.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.planner.plan import Plan
from linkplan.studies.compare.compare import build_tracker, tracking_reference
from linkplan.studies.export.c_files import sizes
from linkplan.studies.export.c_source import identifier
from linkplan.studies.export.c_text import MATH, cmake_text, declared_array, header_of
from linkplan.studies.export.formats import C_TRACKERS
from linkplan.studies.frequency.floquet import linear_law

# A controller's flash rarely holds more; the file would have 100 megabytes of text.
_MAX_NUMBERS = 4_000_000
_TEST_INSTANTS = 64


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LawTables:
    """A linear law at control instants k: references (n, n_s), feedforward (n, n_u) and gains (n or 1, n_u, 2 n_s).

    One gain stands for all instants if it is constant. `limit` (n_u, 2) are effort limits, which the law does not apply.
    """

    prefix: str
    tracker: str
    mechanism: Mechanism
    period_s: float
    position: np.ndarray
    velocity: np.ndarray
    feedforward: np.ndarray
    gains: np.ndarray
    limit: np.ndarray

    def effort(self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return the efforts (n_u,) of the law."""
        error = np.concatenate([self.position[k] - position_rad, self.velocity[k] - velocity_rad_s])
        return self.feedforward[k] + self.gains[k if len(self.gains) > 1 else 0] @ error


def law_tables(plan: Plan, tracker: str) -> LawTables:
    """Return the tables of a built-in tracker on a plan.

    Raises:
        ProblemError: for a tracker that is no linear law, or tables that would be too large.
    """
    choose("tracker for C", tracker, C_TRACKERS, ProblemError)
    reference = tracking_reference(plan)
    law = linear_law(build_tracker(tracker, plan, reference))
    gains, feedforward = law.gains, reference.effort if law.feedforward else np.zeros_like(reference.effort)
    if np.all(gains == gains[0]):
        gains = gains[:1]
    if reference.n * (2 * reference.position_rad.shape[1] + feedforward.shape[1]) + gains.size > _MAX_NUMBERS:
        raise ProblemError(
            f"the tables of {reference.n} control instants have more than {_MAX_NUMBERS} numbers; set a longer"
            " tracking.period_s"
        )
    return LawTables(
        prefix=identifier(plan.problem.name) + "_law",
        tracker=tracker,
        mechanism=plan.problem.mechanism,
        period_s=reference.period_s,
        position=reference.position_rad,
        velocity=reference.velocity_rad_s,
        feedforward=feedforward,
        gains=gains,
        limit=np.array(plan.problem.limits.actuators_effort),
    )


def write_law(tables: LawTables, place: Path, *, compiled: bool = True) -> dict:
    """Write header, source, test and CMake file into a folder, and return what the code costs; `compiled` measures sizes."""
    texts = {
        f"{tables.prefix}.h": _header(tables),
        f"{tables.prefix}.c": _source(tables),
        f"{tables.prefix}_test.c": _test(tables),
        "CMakeLists.txt": cmake_text(tables.prefix),
    }
    for name, text in texts.items():
        (place / name).write_text(text, encoding="utf-8")
    n_u, n_x = tables.gains.shape[1:]
    return {
        "mechanism": tables.mechanism.name,
        "format": "c",
        "files": sorted(texts),
        "tracker": tables.tracker,
        "instants": len(tables.position),
        "period_s": tables.period_s,
        "operations": {"additions": n_x + n_u * n_x, "multiplications": 1 + n_u * n_x},
        "table_numbers": int(sum(x.size for x in _arrays(tables).values())),
        "sizes": sizes(place, f"{tables.prefix}.c", tables.prefix.upper()) if compiled else [],
    }


def _arrays(tables: LawTables) -> Mapping[str, np.ndarray]:
    gains = tables.gains.reshape(len(tables.gains), -1)
    return {"position": tables.position, "velocity": tables.velocity, "feedforward": tables.feedforward, "gains": gains}


def _header(tables: LawTables) -> str:
    mechanism, prefix, upper = tables.mechanism, tables.prefix, tables.prefix.upper()
    n_u, n_x = tables.gains.shape[1:]
    joints = [
        f"  position[{k}] {j.name} [{'rad' if j.kind == 'hinge' else 'm'}]"
        for k, j in enumerate(mechanism.independent_joints)
    ]
    joints += [f"  effort[{k}] {a.name} [{a.unit}], limits {low:g} to {high:g}"
               for k, (a, (low, high)) in enumerate(zip(mechanism.actuators, tables.limit, strict=True))]  # fmt: skip
    about = [
        f"The control law '{tables.tracker}' of a plan of {mechanism.name}, at {len(tables.position)} instants.",
        "",
        "effort = feedforward + gains (reference - state), state = (position, velocity) of the independent joints.",
        "The law keeps no state and does not saturate: limit the effort by the drive, or by the function below.",
        f"Numbers are double, or float where {upper}_FLOAT is defined (for this header and the source file).",
        "",
        *joints,
    ]
    declared = [
        f"#define {upper}_N_S {n_x // 2}\n#define {upper}_N_U {n_u}\n#define {upper}_INSTANTS {len(tables.position)}",
        f"#define {upper}_PERIOD_S {tables.period_s!r}",
        "",
        "/* The effort at time t [s] since the motion's start. The nearest control instant counts: the first one before",
        "   the motion, the last one after it. */",
        f"{_prototype(tables)};",
        "",
        "/* The effort cut to the limits of the drives. */",
        f"void {prefix}_limited({prefix}_real effort[{n_u}]);",
        "",
    ]
    return header_of(prefix, about, declared)


def _prototype(tables: LawTables) -> str:
    real, (n_u, n_x) = f"{tables.prefix}_real", tables.gains.shape[1:]
    n_s = n_x // 2
    return (
        f"void {tables.prefix}({real} t, const {real} position[{n_s}], const {real} velocity[{n_s}], {real} effort[{n_u}])"
    )


def _source(tables: LawTables) -> str:
    prefix, upper, real = tables.prefix, tables.prefix.upper(), f"{tables.prefix}_real"
    n_u, n_x = tables.gains.shape[1:]
    n_s, row = n_x // 2, "k" if len(tables.gains) > 1 else "0"
    arrays = [declared_array(f"static const {real} table_{name}", values, real) for name, values in _arrays(tables).items()]
    limit = np.where(np.isfinite(tables.limit), tables.limit, np.sign(tables.limit) * 1e30)
    arrays.append(declared_array(f"static const {real} limit", limit, real))
    code = f"""
{_prototype(tables)}
{{
  const {real} at = t * ({real})({1.0 / tables.period_s!r});
  int k = 0, i, j;
  if (at > ({real})0) {{
    k = at < ({real})({upper}_INSTANTS - 1) ? (int)MATH(floor)(at + ({real})0.5) : {upper}_INSTANTS - 1;
  }}
  for (j = 0; j < {n_u}; ++j) {{
    {real} sum = table_feedforward[k][j];
    for (i = 0; i < {n_s}; ++i) {{
      sum += table_gains[{row}][{n_x} * j + i] * (table_position[k][i] - position[i]);
      sum += table_gains[{row}][{n_x} * j + {n_s} + i] * (table_velocity[k][i] - velocity[i]);
    }}
    effort[j] = sum;
  }}
}}

void {prefix}_limited({real} effort[{n_u}])
{{
  int j;
  for (j = 0; j < {n_u}; ++j) {{
    if (effort[j] < limit[j][0]) effort[j] = limit[j][0];
    if (effort[j] > limit[j][1]) effort[j] = limit[j][1];
  }}
}}
"""
    return "\n".join([f'#include "{prefix}.h"', "", MATH.format(upper=upper), *arrays, code])


def _test(tables: LawTables) -> str:
    """Return a C program that compares the law with its value in Python; its exit code is 1 if it is off."""
    prefix, upper, real = tables.prefix, tables.prefix.upper(), f"{tables.prefix}_real"
    random, n_u = np.random.default_rng(1), tables.gains.shape[1]
    k = random.integers(0, len(tables.position), _TEST_INSTANTS)
    position = tables.position[k] + 0.01 * random.normal(size=tables.position[k].shape)
    velocity = tables.velocity[k] + 0.1 * random.normal(size=position.shape)
    wanted = np.array([tables.effort(int(i), s, v) for i, s, v in zip(k, position, velocity, strict=True)])
    values = {"t": k * tables.period_s, "position": position, "velocity": velocity, "wanted": wanted}
    arrays = [declared_array(f"static const {real} {name}", value, real) for name, value in values.items()]
    size = float(np.abs(wanted).max()) or 1.0
    code = f"""
#ifdef {upper}_FLOAT
#define BOUND 1e-4
#else
#define BOUND 1e-12
#endif

int main(void)
{{
  double off = 0;
  int k, j;
  for (k = 0; k < {_TEST_INSTANTS}; ++k) {{
    {real} effort[{n_u}];
    {prefix}(t[k], position[k], velocity[k], effort);
    for (j = 0; j < {n_u}; ++j) {{
      double d = (double)effort[j] - (double)wanted[k][j];
      off = (d < 0 ? -d : d) > off ? (d < 0 ? -d : d) : off;
    }}
  }}
  printf("%s: largest difference %g of %g\\n", off <= BOUND * {size!r} ? "as in Python" : "OFF", off, {size!r});
  return !(off <= BOUND * {size!r});
}}
"""
    return "\n".join([f'#include "{prefix}.h"', "", "#include <stdio.h>", "", *arrays, code])
