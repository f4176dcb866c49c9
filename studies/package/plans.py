"""`plan`, `Plan`, `read_plan`, `Planner`, `solve_ocp`: from a problem to a certified motion, or the reason for none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkplan.models.errors import InfeasibleError, LinkplanError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.next_motion import NextMotion
from linkplan.paths import drawn, path_of, times_of
from linkplan.planner import plan as planned
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.files import plan_folder
from linkplan.planner.files.folders import write_whole
from linkplan.planner.files.motion_table import MotionTable, motion_table
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.solve_ocp import OdePlan, plan_ode
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit
from linkplan.planner.refinement.history import Step
from linkplan.planner.replan import Planner as Replanner
from linkplan.problems import Problem
from linkplan.reporting import LOG, Progress, listener

if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingImports]
    from matplotlib.figure import Figure


def plan(problem: Problem | str | Path, progress: Progress | None = None) -> Plan:
    """Return the plan of a problem; without a motion, its `message` has the reason.

    Args:
        problem: a `Problem`, a built-in name or the path of a problem file.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the problem is invalid.
    """
    asked = _problem(problem)
    return Plan(problem=asked, answer=plan_motion(asked.planning, listener(progress)))


def read_plan(
    folder: str | Path,
    *,
    anyway: bool = False,
    extra_costs: Sequence[ExtraCost] = (),
    extra_limits: Sequence[ExtraLimit] = (),
) -> Plan:
    """Return a saved plan, with its problem built again and a new certificate of the saved motion.

    Args:
        folder: of the plan.
        anyway: whether a plan that does not pass its certificate is returned, with status "failed", instead of refused.
        extra_costs: those of the plan. Files do not contain them: without them the objective is not checked, and the plan
            has a note on it.
        extra_limits: likewise, the limits.

    Raises:
        CertificateError: if the motion does not pass.
        LinkplanError: if the folder or a file in it is missing, truncated, or not that of a plan, or its model has changed.
    """
    folder = path_of(folder, "folder")
    answer = plan_folder.read_plan(folder, anyway=anyway, extra_costs=extra_costs, extra_limits=extra_limits)
    note = plan_folder.unchecked(folder)
    if note is not None:
        LOG.warning("%s: %s", folder, note)
    return Plan(problem=Problem(planning=answer.problem), answer=answer)


def solve_ocp(problem: OdeProblem, progress: Progress | None = None) -> OdePlan:
    """Return the solution of an optimal-control problem over any ordinary differential equation.

    Args:
        problem: dynamics, cost, boundary values and limits, in CasADi's SX.
        progress: called with lines on the progress.

    Returns:
        A plan with `status`, `message`, `objective`, `objective_error` (its estimated error), `duration_s` [s],
        `certificate`, `require()` and `trajectory`. The methods `state_at(t)` and `effort_at(t)` of the trajectory return
        states (n, n_x) and efforts (n, n_u) at times (n,).

    Raises:
        LinkplanError: if `problem` is not an `OdeProblem`.
    """
    if not isinstance(problem, OdeProblem):
        raise ProblemError(f"solve_ocp takes an OdeProblem, got {problem!r}")
    return plan_ode(problem, listener(progress))


class Planner:
    """A planner for many problems that differ in numbers only; each solve starts from the last solution, if possible.

    Payload, start, goal, duration, limits, waypoints, weights and references are such numbers. Mutable: it keeps its last
    program. Threads that share a planner wait for each other. A copied or unpickled planner is new and has no `progress`.

    Args:
        progress: called with lines on the progress.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._planner = Replanner(listener(progress))

    def __reduce__(self) -> tuple:
        return Planner, ()  # solvers and locks cannot be pickled

    def plan(self, problem: Problem | str | Path) -> Plan:
        """Return the plan of a problem like `linkplan.plan`, but faster if the last plan is similar.

        Raises:
            LinkplanError: if the problem is invalid.
        """
        asked = _problem(problem)
        return Plan(problem=asked, answer=self._planner.plan(asked.planning))

    def step(self, problem: Problem | str | Path) -> NextMotion | None:
        """Return a motion by a few Newton steps from the last plan, for replanning at the rate of control.

        A step takes a quarter of the time of `plan`, the same in every call but the first. The motion is not certified, but
        has bounds on its error. The next step starts from it. Returns None if the problem differs from the last one in more
        than numbers; then call `plan`.

        Raises:
            LinkplanError: if the problem is invalid.
        """
        asked = _problem(problem)
        step = self._planner.step(asked.planning)
        return None if step is None else NextMotion(problem=asked, step=step)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Plan:
    """A certified motion, or the reason why there is none. `str(plan)` is its report; `to_dict()` has every value.

    Times are in seconds from the motion's start.
    """

    problem: Problem
    answer: planned.Plan

    @property
    def status(self) -> str:
        """The status: "optimal" (converged and certified), "feasible" (certified), "infeasible" or "failed".

        A feasible motion may not be locally optimal; `message` has the reason.
        """
        return self.answer.status

    @property
    def message(self) -> str:
        """The answer in a sentence; without a motion, it names the limit, the joint, the instant and the excess."""
        return self.answer.message

    @property
    def objective(self) -> float | None:
        """The value of the objective in SI units: effort [N2 m2 s], time [s], tracking [rad2 s], ...; None if unknown."""
        return self.answer.objective

    @property
    def duration_s(self) -> float | None:
        """The duration of the motion [s]; None without a motion."""
        return None if self.answer.trajectory is None else self.answer.trajectory.duration_s

    @property
    def certificate(self) -> Certificate | None:
        """The checks between the nodes: `passed`, `failures` and all values, in SI units; None without a motion."""
        return self.answer.certificate

    @property
    def history(self) -> tuple[Step, ...]:
        """The solves before this plan, in order, each with its settings and its result."""
        return self.answer.history

    def require(self) -> Plan:
        """Return this plan if its motion is certified (optimal or feasible).

        Raises:
            InfeasibleError: otherwise: a `LinkplanError` with the message and with the plan as `.plan`.
        """
        if not self.answer.passed:
            raise InfeasibleError(self.message, self)
        return self

    def sample(self, time_s: float | np.ndarray | None = None, *, jumps: bool = False) -> MotionTable:
        """Return the motion at times: `position`, `speed`, `acceleration` by joint and `effort` by actuator.

        Args:
            time_s: a time or times (n,) [s], in any order; by default ten instants of every interval. A periodic motion
                continues beyond its ends, any other motion rests there.
            jumps: whether the default times have both sides of a jump in effort, at equal times; else they increase.

        Returns:
            `time_s`; `position` [deg or m] and `speed` of all joints by name; `acceleration` of the independent joints;
            `effort` [N.m or N] by actuator: arrays (n,), or numbers for a single time. `unit` and `effort_unit` are their
            units; `site` has the sites that the problem names, (n, 3) or (3,) [m] in the world frame. `columns()` returns
            all columns under heads with units.

        Raises:
            LinkplanError: if the plan has no motion, or a time is not finite.
        """
        self._moves("sample")
        time = times_of(time_s)
        table = motion_table(self.answer, None if time is None else np.atleast_1d(time), jumps=jumps)
        return table.single() if time is not None and time.ndim == 0 else table

    def to_frame(self, time_s: np.ndarray | None = None) -> pandas.DataFrame:
        """Return the motion at times (n,) [s] as a pandas table, with a row for each time and units in the columns' names.

        Raises:
            MissingPackageError: if pandas is not installed.
            LinkplanError: as for `sample`.
        """
        table = self.sample(None if time_s is None else np.atleast_1d(time_s))
        return load_extra("pandas", "Plan.to_frame").DataFrame(table.columns())

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of positions, speeds and efforts over time, saved at `path` if it is given.

        Raises:
            LinkplanError: if the plan has no motion.
        """
        self._moves("draw")
        from linkplan.studies.output.draw_plan import plan_figure

        return drawn(path, lambda place: plan_figure(self.answer, place))

    def save(self, folder: str | Path, *, jumps: bool = False) -> Path:
        """Write the plan as a folder, whole or not at all, and return its path: plan.json, trajectory.npz, .csv, plan.png.

        A folder that holds an older plan is replaced. With `jumps`, trajectory.csv has both sides of a jump in effort.

        Raises:
            LinkplanError: if the plan has no motion, the folder has other files, or it cannot be written.
        """
        self._moves("save")
        from linkplan.studies.output.save_plan import save_plan

        target = path_of(folder, "folder")
        write_whole(target, lambda place: save_plan(self.answer, place, target, jumps=jumps))
        return target

    def report(self, path: str | Path) -> Path:
        """Write the plan's report, one HTML file that opens offline, and return its path.

        Raises:
            LinkplanError: if another file exists at the path.
        """
        from linkplan.studies.report.render import write_report
        from linkplan.studies.report.reports import plan_report

        place = path_of(path, "path")
        write_report(plan_report(self.answer), place)
        return place

    def to_dict(self) -> dict:
        """Return the record of plan.json: status, message, certificate, history, problem, versions; units in names."""
        return plan_folder.record(self.answer)

    def _moves(self, what: str) -> None:
        if self.answer.trajectory is None:
            raise LinkplanError(f"nothing to {what}, the plan has no motion: {self.message}")

    def __str__(self) -> str:
        from linkplan.studies.output.plan_text import plan_text

        return plan_text(self.answer)

    def __repr__(self) -> str:
        duration = "no motion" if self.duration_s is None else f"{self.duration_s:.6g} s"
        return f"Plan({self.problem.name!r}, {self.status}, {duration})"


def _problem(problem: object) -> Problem:
    if isinstance(problem, str | Path):
        return Problem.from_file(problem)
    if not isinstance(problem, Problem):
        raise ProblemError(f"what is planned is a Problem, a built-in problem's name or a TOML file, got {problem!r}")
    return problem
