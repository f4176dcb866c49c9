"""A plan's control law as C99: tables over time and their interpolation, effort = law(t, position, velocity)."""

from pathlib import Path

import numpy as np

from linkplan.studies.handover.export.c_files import ObjectSize, size_blocks, sizes
from linkplan.studies.handover.export.c_text import (
    MATH,
    NO_LIMIT,
    bounded,
    declared_array,
    header_of,
    limit_macros,
    write_texts,
)
from linkplan.studies.handover.export.exported import Exported
from linkplan.studies.handover.export.law_tables import ROW_SHARE, LawTables, arrays_of
from linkplan.studies.output.document import Block, Text

# Steps of sharing efforts, a constant number in constant time, and their damping: each leaves 0.6 / 1.6 of the error.
_SHARING_STEPS, _DAMPING_SHARE = 40, 0.6


class LawRecord(Exported, frozen=True, kw_only=True):
    """The record of a plan's control law in C; `instants` are the rows of its tables."""

    mechanism: str
    format: str = "c"
    files: list[str]
    tracker: str
    instants: int
    duration_s: float
    periodic: bool
    period_s: float
    model_hash: str
    plan_hash: str
    table_numbers: int
    sizes: list[ObjectSize]
    plan: str

    def blocks(self) -> list[Block]:
        """Return the record of the files in a folder as a document's blocks."""
        ends = "repeats" if self.periodic else "holds start and goal"
        law = f"{self.tracker} over {self.duration_s:g} s in {self.instants} rows, {self.table_numbers} numbers; it {ends}"
        written = Text(text=f"{self.path}: {', '.join(self.files)}", tone="good")
        return [written, Text(text=law), *size_blocks(self.sizes)]


def write_law(tables: LawTables, place: Path, plan: str, *, compiled: bool = True) -> LawRecord:
    """Write header, source, test and CMake file of a plan's law into a folder, and return its record.

    `plan` is the name of the plan's problem; `compiled` says whether sizes are measured.
    """
    files = write_texts(place, tables.prefix, _header(tables), _source(tables), _test(tables))
    return LawRecord(
        mechanism=tables.mechanism.name,
        files=files,
        tracker=tables.tracker,
        instants=len(tables.time_s),
        duration_s=float(tables.time_s[-1]),
        periodic=tables.periodic,
        period_s=tables.period_s,
        model_hash=tables.mechanism.fingerprint(),
        plan_hash=tables.plan_hash,
        table_numbers=int(sum(x.size for x in arrays_of(tables).values())),
        sizes=sizes(place, f"{tables.prefix}.c", tables.prefix.upper()) if compiled else [],
        plan=plan,
    )


def _header(tables: LawTables) -> str:
    mechanism, prefix, upper, limits = tables.mechanism, tables.prefix, tables.prefix.upper(), tables.limits
    n_u, n_x = tables.gains.shape[1:]
    joints = [f"  position[{k}] {j.name} [{j.si_units[0]}]" for k, j in enumerate(mechanism.independent_joints)]
    joints += [
        f"  effort[{k}] {a.name} [{a.unit}], limits {low:g} to {high:g}"
        for k, (a, (low, high)) in enumerate(zip(mechanism.actuators, limits.actuators_effort, strict=True))
    ]
    begins = "repeats after each period" if tables.periodic else "holds the start before the motion and the goal after it"
    about = [
        f"The control law '{tables.tracker}' of a plan of {mechanism.name}, as tables of {len(tables.time_s)} rows.",
        "",
        "effort = feedforward + gains (reference - state), state = (position, velocity) of the independent joints.",
        f"The law {begins}. It has no state and does not",
        "saturate: limit the effort by the drive, or by the function below.",
        f"Numbers are double, or float where {upper}_FLOAT is defined (for this header and the source file).",
        "Compile without options that assume finite numbers (-ffast-math).",
        "",
        *joints,
    ]
    names, actuators = [j.name for j in mechanism.joints], mechanism.actuators
    units = [j.si_units[0] for j in mechanism.joints]
    rates = [f"{unit}/s" for unit in units]
    declared = [
        f'#define {upper}_MODEL_HASH "{mechanism.fingerprint()}"',
        f'#define {upper}_PLAN_HASH "{tables.plan_hash}"',
        f"#define {upper}_N_S {n_x // 2}\n#define {upper}_N_U {n_u}\n#define {upper}_INSTANTS {len(tables.time_s)}",
        f"#define {upper}_PERIOD_S {tables.period_s!r}",
        f"#define {upper}_DURATION_S {float(tables.time_s[-1])!r}",
        "",
        f"/* The plan's limits: Q of all joints, V of their speeds, U of the drives' efforts; {NO_LIMIT:g} means none. */",
        *limit_macros(prefix, "Q", names, limits.position, units),
        *limit_macros(prefix, "V", names, limits.speed, rates),
        *limit_macros(prefix, "U", [a.name for a in actuators], limits.actuators_effort, [a.unit for a in actuators]),
        "",
        "/* The effort at time t [s] since the motion's start, any time, by interpolation between the rows.",
        "   Returns 0, or 1 if t, a position or a velocity is not finite: the effort is then the feedforward alone. */",
        f"{_prototype(tables)};",
        "",
        "/* Saturates the effort at the drives' limits. Returns 0, or 1 if an effort was not a number: it is then the",
        "   limit that is nearest to zero, or zero."
        + (" */" if tables.maps is None else " What one motor lacks, the others give as far as they can. */"),
        f"{_limited_prototype(tables)};",
        "",
    ]
    return header_of(prefix, about, declared)


def _prototype(tables: LawTables) -> str:
    real, (n_u, n_x) = f"{tables.prefix}_real", tables.gains.shape[1:]
    n_s = n_x // 2
    return f"int {tables.prefix}({real} t, const {real} position[{n_s}], const {real} velocity[{n_s}], {real} effort[{n_u}])"


def _limited_prototype(tables: LawTables) -> str:
    real, time = f"{tables.prefix}_real", "" if tables.maps is None else f"{tables.prefix}_real t, "
    return f"int {tables.prefix}_limited({time}{real} effort[{tables.gains.shape[1]}])"


def _source(tables: LawTables) -> str:
    upper, real = tables.prefix.upper(), f"{tables.prefix}_real"
    arrays = [
        declared_array(f"static const {real} table_{name}", values, real) for name, values in arrays_of(tables).items()
    ]
    arrays.append(declared_array(f"static const {real} limit", bounded(tables.limits.actuators_effort), real))
    if tables.periodic:
        arrays.append(declared_array(f"static const {real} advance", tables.advance, real))
    code = [_row_code(tables, real), _law_code(tables, real), _limited_code(tables, real)]
    return "\n".join([f'#include "{tables.prefix}.h"', "", MATH.format(upper=upper), *arrays, "", *code])


def _row_code(tables: LawTables, real: str) -> str:
    """Return the C function that finds the rows around a time."""
    n, near = len(tables.time_s), f"({real}){ROW_SHARE * tables.period_s!r}"
    outside = f"""  if (!(t >= -{near})) return 0;
  if (t > table_time[{n - 1}] + {near}) return {n + 1};
"""
    return f"""/* Return the row at or before time t; w is the time since it as a share of the step to the next one. */
static int row_at({real} t, {real} *w, {real} *step)
{{
  int low = 0, high = {n - 1};
  *w = 0;
  *step = 1;
{"" if tables.periodic else outside}  while (high - low > 1) {{
    const int middle = (low + high) / 2;
    if (t >= table_time[middle]) low = middle; else high = middle;
  }}
  if (table_time[high] - t < {near}) return high + {tables.held};
  if (t - table_time[low] >= {near}) {{
    *step = table_time[high] - table_time[low];
    *w = (t - table_time[low]) / *step;
  }}
  return low + {tables.held};
}}
"""


def _law_code(tables: LawTables, real: str) -> str:
    """Return the C function of the law."""
    n_u, n_x = tables.gains.shape[1:]
    n_s = n_x // 2
    rows = ("0", "0") if len(tables.gains) == 1 else ("k", "m")
    moved = " + periods * advance[i]" if tables.periodic else ""
    return f"""{_prototype(tables)}
{{
  {real} w, step, error[{n_x}];
{f"  {real} periods;" + chr(10) if tables.periodic else ""}  int k, m, i, j, failed = !(t == t);
{_wrapped_code(tables, real)}  if (!(t == t)) {{
    failed = 1;
    t = 0;
{"    periods = 0;" + chr(10) if tables.periodic else ""}  }}
  k = row_at(t, &w, &step);
  m = w > 0 ? k + 1 : k;
  for (i = 0; i < {n_s}; ++i) {{
    const {real} p = table_position[k][i], d = table_position[m][i] - p;
    const {real} v = step * table_velocity[k][i], v_next = step * table_velocity[m][i];
    const {real} a = 3 * d - 2 * v - v_next, b = v + v_next - 2 * d;
    error[i] = p + w * (v + w * (a + w * b)){moved} - position[i];
    error[{n_s} + i] = (v + w * (2 * a + 3 * w * b)) / step - velocity[i];
  }}
  for (j = 0; j < {n_u}; ++j) {{
    const {real} forward = (1 - w) * table_feedforward[k][j] + w * table_feedforward[m][j];
    {real} sum = forward;
    for (i = 0; i < {n_x}; ++i) {{
      const {real} gain = (1 - w) * table_gains[{rows[0]}][{n_x} * j + i] + w * table_gains[{rows[1]}][{n_x} * j + i];
      sum += gain * error[i];
    }}
    if (!(sum - sum == 0)) {{
      sum = forward;
      failed = 1;
    }}
    effort[j] = sum;
  }}
  return failed;
}}
"""


def _wrapped_code(tables: LawTables, real: str) -> str:
    period = f"({real}){float(tables.time_s[-1])!r}"
    return f"  periods = MATH(floor)(t / {period});\n  t -= periods * {period};\n" if tables.periodic else ""


def _shared_code(tables: LawTables, real: str) -> str:
    """Return the C function by which more actuators than freedoms share efforts, or nothing.

    The nearest u within the limits with R u = R u_0 is clip(u_0 + R^T p), and p (n_s,) maximises a concave function with the
    gradient R (u_0 - u). Its ascent by the Newton matrix of the motors between their limits plus a share of that of all
    never overshoots, if the share is above 1/2: all motors' matrix bounds the curvature.
    """
    if tables.maps is None:
        return ""
    n_u, n_s = tables.maps.shape[1:]
    return f"""/* Replaces efforts beyond limits by the nearest within them that give the joints the same, at time t. */
static void share({real} t, {real} effort[{n_u}])
{{
  {real} w, step, map[{n_u}][{n_s}], given[{n_u}], wanted[{n_s}], p[{n_s}], size[{n_s}], A[{n_s}][{n_s + 1}];
{f"  {real} periods;" + chr(10) if tables.periodic else ""}  int k, m, i, j, l, again, beyond = 0;
  for (j = 0; j < {n_u}; ++j) {{
    if (!(effort[j] - effort[j] == 0)) return;
    beyond = beyond || effort[j] < limit[j][0] || effort[j] > limit[j][1];
  }}
  if (!beyond) return;
{_wrapped_code(tables, real)}  k = row_at(t == t ? t : 0, &w, &step);
  m = w > 0 ? k + 1 : k;
  for (i = 0; i < {n_s}; ++i) {{
    wanted[i] = p[i] = 0;
    for (j = 0; j < {n_u}; ++j) {{
      map[j][i] = (1 - w) * table_maps[k][{n_s} * j + i] + w * table_maps[m][{n_s} * j + i];
      wanted[i] += map[j][i] * effort[j];
    }}
  }}
  for (again = 0; again < {_SHARING_STEPS}; ++again) {{
    for (i = 0; i < {n_s}; ++i) {{
      for (l = 0; l < {n_s}; ++l) A[i][l] = 0;
      A[i][{n_s}] = wanted[i];
    }}
    for (j = 0; j < {n_u}; ++j) {{
      given[j] = effort[j];
      for (i = 0; i < {n_s}; ++i) given[j] += map[j][i] * p[i];
      beyond = given[j] <= limit[j][0] || given[j] >= limit[j][1];
      if (given[j] < limit[j][0]) given[j] = limit[j][0];
      if (given[j] > limit[j][1]) given[j] = limit[j][1];
      for (i = 0; i < {n_s}; ++i) {{
        A[i][{n_s}] -= map[j][i] * given[j];
        for (l = 0; l < {n_s}; ++l) A[i][l] += (({real}){_DAMPING_SHARE!r} + !beyond) * map[j][i] * map[j][l];
      }}
    }}
    for (i = 0; i < {n_s}; ++i) size[i] = A[i][i];
    for (i = 0; i < {n_s}; ++i) {{
      if (!(A[i][i] > ({real})1e-6 * size[i])) continue;
      for (l = 0; l < {n_s}; ++l) {{
        const {real} factor = A[l][i] / A[i][i];
        for (j = i; l != i && j <= {n_s}; ++j) A[l][j] -= factor * A[i][j];
      }}
    }}
    for (i = 0; i < {n_s}; ++i)
      if (A[i][i] > ({real})1e-6 * size[i]) p[i] += A[i][{n_s}] / A[i][i];
  }}
  for (j = 0; j < {n_u}; ++j) effort[j] = given[j];
}}

"""


def _limited_code(tables: LawTables, real: str) -> str:
    """Return the C function that limits efforts to the drives' limits."""
    n_u = tables.gains.shape[1]
    return f"""{_shared_code(tables, real)}{_limited_prototype(tables)}
{{
  int j, failed = 0;
  for (j = 0; j < {n_u}; ++j) {{
    if (!(effort[j] == effort[j])) {{
      effort[j] = 0;
      failed = 1;
    }}
  }}
{"" if tables.maps is None else "  share(t, effort);" + chr(10)}  for (j = 0; j < {n_u}; ++j) {{
    if (effort[j] < limit[j][0]) effort[j] = limit[j][0];
    if (effort[j] > limit[j][1]) effort[j] = limit[j][1];
  }}
  return failed;
}}
"""


def _test(tables: LawTables) -> str:
    """Return a C program that compares the law with its value in Python; its exit code is 1 if they differ."""
    prefix, upper, real = tables.prefix, tables.prefix.upper(), f"{tables.prefix}_real"
    random, n_u, end = np.random.default_rng(1), tables.gains.shape[1], float(tables.time_s[-1])
    # at the control instants, where efforts jump between rows, and before and after the motion
    at = np.round(random.uniform(-0.1, 1.1, 64) * end / tables.period_s) * tables.period_s
    middle = tables.position.mean(axis=0)
    position = middle + 0.01 * random.normal(size=(len(at), len(middle)))
    velocity = 0.1 * random.normal(size=position.shape)
    wanted = np.array([tables.effort(float(t), s, v) for t, s, v in zip(at, position, velocity, strict=True)])
    values = {"t": at, "position": position, "velocity": velocity, "wanted": wanted}
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
  for (k = 0; k < {len(at)}; ++k) {{
    {real} effort[{n_u}];
    if ({prefix}(t[k], position[k], velocity[k], effort)) off = HUGE_VAL;
    for (j = 0; j < {n_u}; ++j) {{
      double d = (double)effort[j] - (double)wanted[k][j];
      off = (d < 0 ? -d : d) > off ? (d < 0 ? -d : d) : off;
    }}
  }}
  printf("%s: largest difference %g of %g\\n", off <= BOUND * {size!r} ? "as in Python" : "OFF", off, {size!r});
  return !(off <= BOUND * {size!r});
}}
"""
    return "\n".join([f'#include "{prefix}.h"', "", "#include <math.h>", "#include <stdio.h>", "", *arrays, code])
