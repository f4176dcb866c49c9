"""`plan`, `Plan`, `read_plan`, `Planner`, `solve_ocp`: from a problem to a certified motion, or the reason for none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.paths import drawn, path_of
from linkplan.planner import plan as planned
from linkplan.planner import plan_folder
from linkplan.planner.files.columns import csv_bytes
from linkplan.planner.files.folders import plain_record, write_json, write_whole
from linkplan.planner.ode import plan as ode_planned
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.ode.solve_ocp import plan_ode
from linkplan.planner.planning import plan_motion
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit
from linkplan.planner.problem.problem import Problem
from linkplan.planner.replan import NextMotion, Replanner
from linkplan.reporting import LOG, Progress, listener

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


def plan(problem: Problem | str | Path, progress: Progress | None = None, *, prove: bool = False) -> Plan:
    """Return the plan of a problem; without a motion, its `message` has the reason.

    Args:
        problem: a `Problem`, a built-in name or the path of a problem file.
        progress: called with lines on the progress.
        prove: whether its motion is proved; the result is the plan's `proof`.

    Raises:
        LinkplanError: if the problem is invalid.

    Example::

        print(linkplan.plan("knee-reach"))
    """
    found = Plan.of(plan_motion(_problem(problem), listener(progress)))
    return found.with_proof() if prove and found.trajectory is not None else found


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

    Example::

        linkplan.plan("knee-reach").save("reach")
        print(linkplan.read_plan("reach").duration_s)
    """
    folder = path_of(folder, "folder")
    answer = plan_folder.read_plan(folder, anyway=anyway, extra_costs=extra_costs, extra_limits=extra_limits)
    note = plan_folder.unchecked(folder)
    if note is not None:
        LOG.warning("%s: %s", folder, note)
    return Plan.of(answer)


def solve_ocp(problem: OdeProblem, progress: Progress | None = None) -> OdePlan:
    """Return the solution of an optimal-control problem over any ordinary differential equation.

    Args:
        problem: dynamics, cost, boundary values and limits, in CasADi's SX.
        progress: called with lines on the progress.

    Returns:
        A plan with `status`, `message`, `objective`, `objective_error` (its estimated error), `duration_s` [s],
        `certificate`, `require()`, `plot()`, `to_frame()`, `save()` and `trajectory`. The methods `state_at(t)` and
        `effort_at(t)` of the trajectory return states (n, n_x) and efforts (n, n_u) at times (n,), in the problem's units.

    Raises:
        LinkplanError: if `problem` is not an `OdeProblem`.

    Example::

        cart = linkplan.OdeProblem(
            name="cart",
            rate=lambda x, u, p, t: [x[1], u[0]],
            start=[0, 0],
            goal=[1, 0],
            effort_limit=[[-1, 1]],
            duration_s=2.5,
            running_cost=lambda x, u, p, t: u[0] ** 2,
        )
        print(linkplan.solve_ocp(cart))
    """
    if not isinstance(problem, OdeProblem):
        raise ProblemError(f"solve_ocp takes an OdeProblem, got {problem!r}")
    return OdePlan.of(plan_ode(problem, listener(progress)))


class Planner:
    """A planner for many problems that differ in numbers only; each solve starts from the last solution, if possible.

    Payload, start, goal, duration, limits, waypoints, weights and references are such numbers. Mutable: it keeps its last
    program. Threads that share a planner wait for each other. A copied or unpickled planner is new and has no `progress`.

    Args:
        progress: called with lines on the progress.

    Example::

        planner = linkplan.Planner()
        reach = linkplan.Problem.from_file("knee-reach")
        for goal in (56.27, 55.0):
            print(planner.plan(reach.replace(goal_deg={"O": goal})).objective)
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
        return Plan.of(self._planner.plan(_problem(problem)))

    def step(self, problem: Problem | str | Path) -> NextMotion | None:
        """Return a motion by a few Newton steps from the last plan, for replanning at the rate of control.

        A step takes a quarter of the time of `plan`, the same in every call but the first. The motion is not certified, but
        has bounds on its error. The next step starts from it. Returns None if the problem differs from the last one in more
        than numbers, or if that was planned without a program, as least times along limits on power, pin force or speed are;
        then call `plan`.

        Raises:
            LinkplanError: if the problem is invalid.
        """
        return self._planner.step(_problem(problem))


class Plan(planned.Plan):
    """A certified motion, or the reason why there is none. `str(plan)` is its report; `to_dict()` has every value.

    Times are in seconds from the motion's start. It is the planner's plan; its own members need files, figures and reports,
    which the planner cannot import.

    Example::

        plan = linkplan.plan("knee-reach").require()
        print(plan.status, plan.objective, plan.sample(0.08).effort["act_O"])  # N.m
    """

    __slots__ = ()

    @classmethod
    def of(cls, plan: planned.Plan) -> Plan:
        """Return the planner's plan with these members."""
        return cls(**{field.name: getattr(plan, field.name) for field in fields(plan)})

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of positions, speeds and efforts over time, saved at `path` if it is given.

        Raises:
            LinkplanError: if the plan has no motion.
        """
        self.require_motion("draw")
        from linkplan.studies.output.draw_plan import plan_figure

        return drawn(path, lambda place: plan_figure(self, place))

    def save(self, folder: str | Path, *, jumps: bool = False) -> Path:
        """Write the plan as a folder, whole or not at all, and return its path: plan.json, trajectory.npz, .csv, plan.png.

        A folder that holds an older plan is replaced. With `jumps`, trajectory.csv has both sides of a jump in effort.

        Raises:
            LinkplanError: if the plan has no motion, the folder has other files, or it cannot be written.
        """
        self.require_motion("save")
        from linkplan.studies.output.draw_plan import save_plan

        target = path_of(folder, "folder")
        write_whole(target, lambda place: save_plan(self, place, target, jumps=jumps))
        return target

    def report(self, path: str | Path) -> Path:
        """Write the plan's report, one HTML file that opens offline, and return its path.

        Raises:
            LinkplanError: if another file exists at the path.
        """
        from linkplan.studies.report.render import write_report
        from linkplan.studies.report.reports import plan_report

        place = path_of(path, "path")
        write_report(plan_report(self), place)
        return place

    def to_dict(self) -> dict:
        """Return the record of plan.json: status, message, certificate, history, problem, versions; units in names."""
        return plan_folder.record(self)

    def _repr_html_(self) -> str:
        from linkplan.studies.output.plan_blocks import plan_blocks
        from linkplan.studies.output.text import html_of, in_brief

        return html_of(in_brief(plan_blocks(self)))

    def __str__(self) -> str:
        from linkplan.studies.output.plan_blocks import plan_blocks
        from linkplan.studies.output.text import in_brief, text_of

        return text_of(in_brief(plan_blocks(self)))


class OdePlan(ode_planned.OdePlan):
    """The solution of an `OdeProblem`, or the reason why there is none; states and efforts are in the problem's units."""

    __slots__ = ()

    @classmethod
    def of(cls, plan: ode_planned.OdePlan) -> OdePlan:
        """Return the planner's solution with these members."""
        return cls(**{field.name: getattr(plan, field.name) for field in fields(plan)})

    def sample(self, time_s: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return columns (n,) by name: time [s], states and efforts, at times (n,) [s] or ten in each interval.

        Raises:
            LinkplanError: if there is no motion, or a time is not within it.
        """
        if self.trajectory is None:
            raise LinkplanError(f"no motion to sample: {self.message}")
        time = self.trajectory.dense_times(10) if time_s is None else np.atleast_1d(planned.asked_times(time_s))
        end = self.trajectory.duration_s
        if np.any(np.abs(2 * time - end) > end * (1 + 1e-9)):
            raise ProblemError(f"times are from 0 to {end:.7g} s, where the motion ends, got {time_s!r}")
        columns = {"time [s]": time}
        for names, values in (
            (self.problem.states, self.trajectory.state_at(time)),
            (self.problem.efforts, self.trajectory.effort_at(time)),
        ):
            columns |= {str(name): values[:, k] for k, name in enumerate(names)}
        return columns

    def to_frame(self, time_s: np.ndarray | None = None) -> pandas.DataFrame:
        """Return `sample` as a pandas table, with a row for each time.

        Raises:
            MissingPackageError: if pandas is not installed.
            LinkplanError: if there is no motion.
        """
        return load_extra("pandas", "OdePlan.to_frame").DataFrame(self.sample(time_s))

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of states and efforts over time, saved at `path` if it is given.

        Raises:
            LinkplanError: if there is no motion.
        """
        from linkplan.studies.output.figure import figure_of
        from linkplan.studies.output.lines import TIME, Line, plots

        (_, time), *columns = self.sample().items()
        limits = [*self.problem.state_limit, *self.problem.effort_limit]
        lines = [
            Line(name=name, values=values, unit="1", limits=tuple(ends))
            for (name, values), ends in zip(columns, limits, strict=True)
        ]
        states, efforts = lines[: self.problem.n_x], lines[self.problem.n_x :]
        panels = [*plots("States", "state", TIME, time, states), *plots("Efforts", "effort", TIME, time, efforts)]
        title = f"{self.problem.name}: {self.message}"
        return drawn(path, lambda place: figure_of(panels, place, title=title, panel_in=(7.0, 2.7)))

    def save(self, folder: str | Path) -> Path:
        """Write the solution as a folder, whole or not at all, and return its path: ode.json, trajectory.csv, plan.png.

        Raises:
            LinkplanError: if there is no motion, the folder has other files, or it cannot be written.
        """
        target, columns = path_of(folder, "folder"), self.sample()

        def write(place: Path) -> None:
            write_json(place / "ode.json", self.to_dict())
            (place / "trajectory.csv").write_bytes(csv_bytes(columns))
            self.plot(place / "plan.png")

        write_whole(target, write, "ode.json")
        return target

    def to_dict(self) -> dict:
        """Return name, status, message, objective, its estimated error and duration [s], in JSON types."""
        values = {"status": self.status, "message": self.message, "objective": self.objective}
        return plain_record(
            {"name": self.problem.name, **values, "objective_error": self.objective_error, "duration_s": self.duration_s}
        )

    def _repr_html_(self) -> str:
        from linkplan.studies.output.document import Facts
        from linkplan.studies.output.text import html_of

        return html_of([Facts(rows=[(key, f"{value}") for key, value in self.to_dict().items()])])


def _problem(problem: object) -> Problem:
    if isinstance(problem, str | Path):
        return Problem.from_file(problem)
    if not isinstance(problem, Problem):
        raise ProblemError(f"what is planned is a Problem, a built-in problem's name or a TOML file, got {problem!r}")
    return problem
