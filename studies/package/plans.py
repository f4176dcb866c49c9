"""`plan`, `Plan`, `read_plan`, `Planner`, `solve_ocp`: from a problem to a certified motion, or why there is none."""

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
    """Return the plan of a problem; one without an answer says why in `message`.

    Args:
        problem: what to plan; a built-in name or a problem file's path will do.
        progress: called with a line of text now and then.

    Raises:
        LinkplanError: when the problem is none.
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
    """Return a saved plan: its problem built again, its certificate made anew from the motion on disk.

    Args:
        folder: where it was saved.
        anyway: whether a plan whose motion does not pass its certificate is returned, its status "failed", and not refused.
        extra_costs: those that it was planned with. Files do not hold them: without them the objective is not checked, which
            a note of the plan says.
        extra_limits: likewise, the limits.

    Raises:
        CertificateError: when the motion does not pass.
        LinkplanError: when the folder or a file in it is missing, truncated, no plan's, or its model has changed since.
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
        progress: called with a line of text now and then.

    Returns:
        A plan with `status`, `message`, `objective`, `certificate`, `require()` and `trajectory`, whose `state_at(t)` and
        `effort_at(t)` give states (n, n_x) and efforts (n, n_u) at times (n,).

    Raises:
        LinkplanError: when the problem is no `OdeProblem`.
    """
    if not isinstance(problem, OdeProblem):
        raise ProblemError(f"solve_ocp takes an OdeProblem, got {problem!r}")
    return plan_ode(problem, listener(progress))


class Planner:
    """A planner for many problems that differ in numbers: each is solved from the last one's solution where that serves.

    Payload, start, goal, duration, limits, waypoints, weights and references are such numbers. Mutable: it keeps its last
    program; threads that share a planner wait for each other. A copy, or one that a pickle brings to another process, is a
    new one, without `progress`.

    Args:
        progress: called with a line of text now and then.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._planner = Replanner(listener(progress))

    def __reduce__(self) -> tuple:
        return Planner, ()  # solvers and locks are this process's own

    def plan(self, problem: Problem | str | Path) -> Plan:
        """Return the plan of a problem, as `linkplan.plan` does, sooner where it can.

        Raises:
            LinkplanError: when the problem is none.
        """
        asked = _problem(problem)
        return Plan(problem=asked, answer=self._planner.plan(asked.planning))

    def step(self, problem: Problem | str | Path) -> NextMotion | None:
        """Return the motion to which a few Newton steps lead from the last plan, for replanning at the rate of control.

        A quarter of the time of `plan`, the same in every call but the first. It is not certified: its error is bounded.
        The next step begins here. None where the last plan differs from the problem in more than numbers: `plan` it.

        Raises:
            LinkplanError: when the problem is none.
        """
        asked = _problem(problem)
        step = self._planner.step(asked.planning)
        return None if step is None else NextMotion(problem=asked, step=step)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Plan:
    """A certified motion, or none and the reason. `str(plan)` is its report; `to_dict()` has every figure of it.

    `problem` is what was asked. Times are in seconds from the motion's start.
    """

    problem: Problem
    answer: planned.Plan

    @property
    def status(self) -> str:
        """How it ended: "optimal" (converged and certified), "feasible" (certified), "infeasible" or "failed".

        A feasible motion is not known to be the best of those near to it: `message` says why.
        """
        return self.answer.status

    @property
    def message(self) -> str:
        """The answer in a sentence: of a plan without a motion, which limit, which joint, when, by how much."""
        return self.answer.message

    @property
    def objective(self) -> float | None:
        """What was least, in SI units: effort [N2 m2 s], time [s], tracking [rad2 s], work [J], ...; None if unknown."""
        return self.answer.objective

    @property
    def duration_s(self) -> float | None:
        """How long the motion takes [s]; None without one."""
        return None if self.answer.trajectory is None else self.answer.trajectory.duration_s

    @property
    def certificate(self) -> Certificate | None:
        """What was checked between the nodes: `passed`, `failures` and every figure, in SI units; None without a motion."""
        return self.answer.certificate

    @property
    def history(self) -> tuple[Step, ...]:
        """The solves that led here, in order, each with what was tried and what came of it."""
        return self.answer.history

    def require(self) -> Plan:
        """Return this plan if its motion is certified, be it optimal or feasible.

        Raises:
            InfeasibleError: a `LinkplanError` with the message, carrying the plan as `.plan`, if it has none.
        """
        if not self.answer.passed:
            raise InfeasibleError(self.message, self)
        return self

    def sample(self, time_s: float | np.ndarray | None = None, *, jumps: bool = False) -> MotionTable:
        """Return the motion at times: `position`, `speed`, `acceleration` by joint and `effort` by actuator.

        Args:
            time_s: a time or times (n,) [s], in any order; by default ten instants of every interval. A periodic motion
                goes on beyond its ends, any other rests there.
            jumps: whether the default times have both sides of a jump in effort, at one time; else they increase strictly.

        Returns:
            `time_s`; `position` [deg or m], dependent joints too, and `speed`, by joint; `acceleration` of the independent
            joints; `effort` [N.m or N] by actuator: arrays (n,), or numbers of a single time. `unit` and `effort_unit` say
            which; `site` are the sites that the problem names, (n, 3) or (3,) [m] in the world. `columns()` has all under
            heads with units.

        Raises:
            LinkplanError: when the plan has no motion, or a time is no finite number.
        """
        self._moves("sample")
        time = times_of(time_s)
        table = motion_table(self.answer, None if time is None else np.atleast_1d(time), jumps=jumps)
        return table.single() if time is not None and time.ndim == 0 else table

    def to_frame(self, time_s: np.ndarray | None = None) -> pandas.DataFrame:
        """Return the motion at times (n,) [s] as a pandas table, one row a time, units in the columns' names.

        Raises:
            MissingPackageError: when pandas is not installed.
            LinkplanError: as `sample` does.
        """
        table = self.sample(None if time_s is None else np.atleast_1d(time_s))
        return load_extra("pandas", "Plan.to_frame").DataFrame(table.columns())

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of positions, speeds and efforts over time; it is saved at `path` where one is given.

        Raises:
            LinkplanError: when the plan has no motion.
        """
        self._moves("draw")
        from linkplan.studies.output.draw_plan import plan_figure

        return drawn(path, lambda place: plan_figure(self.answer, place))

    def save(self, folder: str | Path, *, jumps: bool = False) -> Path:
        """Write the plan as a folder, whole or not at all, and return its path: plan.json, trajectory.npz, .csv, plan.png.

        A folder that holds an older plan is replaced. With `jumps`, trajectory.csv has both sides of a jump in effort.

        Raises:
            LinkplanError: when the plan has no motion, the folder holds other files, or the disk refuses.
        """
        self._moves("save")
        from linkplan.studies.output.save_plan import save_plan

        target = path_of(folder, "folder")
        write_whole(target, lambda place: save_plan(self.answer, place, target, jumps=jumps))
        return target

    def report(self, path: str | Path) -> Path:
        """Write the plan's report, one HTML file that opens offline, and return its path.

        Raises:
            LinkplanError: when something that is no report stands there.
        """
        from linkplan.studies.report.render import write_report
        from linkplan.studies.report.reports import plan_report

        place = path_of(path, "path")
        write_report(plan_report(self.answer), place)
        return place

    def to_dict(self) -> dict:
        """Return what plan.json has of a plan: status, message, certificate, history, problem, versions; units in names."""
        return plan_folder.record(self.answer)

    def _moves(self, what: str) -> None:
        if self.answer.trajectory is None:
            raise LinkplanError(f"nothing to {what}, the plan has no motion: {self.message}")

    def __str__(self) -> str:
        from linkplan.studies.output.plan_text import plan_text

        return plan_text(self.answer)

    def __repr__(self) -> str:
        lasts = "no motion" if self.duration_s is None else f"{self.duration_s:.6g} s"
        return f"Plan({self.problem.name!r}, {self.status}, {lasts})"


def _problem(problem: object) -> Problem:
    if isinstance(problem, str | Path):
        return Problem.from_file(problem)
    if not isinstance(problem, Problem):
        raise ProblemError(f"what is planned is a Problem, a built-in problem's name or a TOML file, got {problem!r}")
    return problem
