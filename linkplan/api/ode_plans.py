"""`solve_ocp`: optimal control of any ordinary differential equation."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from linkplan.api.paths import drawn, path_of
from linkplan.api.reporting import Progress, listener
from linkplan.api.results import Shown
from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.planner.files.columns import csv_bytes
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.ode import plan as ode_planned
from linkplan.planner.ode.plan import plan_ode
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.plan import plan as planned

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from linkplan.studies.output.document import Block


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


class OdeRecord(Struct, frozen=True, kw_only=True):
    """The record of a solution, `ode.json`. The objective and its estimated error are in the problem's units."""

    name: str
    status: str
    message: str
    objective: float | None
    objective_error: float | None
    duration_s: float | None


class OdePlan(ode_planned.OdePlan, Shown):
    """The solution of an `OdeProblem`, or the reason why there is none; states and efforts are in the problem's units."""

    __slots__ = ()

    @classmethod
    def of(cls, plan: ode_planned.OdePlan) -> OdePlan:
        """Return the planner's solution as this class."""
        return cls(**{field.name: getattr(plan, field.name) for field in fields(plan)})

    def sample(self, time_s: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return columns (n,) by name: time [s], states and efforts, at times (n,) [s], by default ten per interval.

        Raises:
            LinkplanError: if there is no motion, or a time is not within it.
        """
        if self.trajectory is None:
            raise LinkplanError(f"cannot sample: there is no motion: {self.message}")
        end_s = self.trajectory.duration_s
        time = self.trajectory.dense_times() if time_s is None else np.atleast_1d(planned.asked_times(time_s, end_s))
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
        from linkplan.studies.output.figure_spec import FigureSpec
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
        return drawn(path, lambda: FigureSpec(panels=panels, title=title, panel_in=(7.0, 2.7)))

    def save(self, folder: str | Path) -> Path:
        """Write the solution as a folder, completely or not at all, and return its path: ode.json, trajectory.csv, plan.png.

        Raises:
            LinkplanError: if there is no motion, the folder has other files, or it cannot be written.
        """
        target, columns = path_of(folder, "folder"), self.sample()

        def write(place: Path) -> None:
            write_json(place / "ode.json", self.struct)
            (place / "trajectory.csv").write_bytes(csv_bytes(columns))
            self.plot(place / "plan.png")

        write_whole(target, write, "ode.json")
        return target

    @property
    def struct(self) -> OdeRecord:
        """The record of ode.json."""
        values = {name: getattr(self, name) for name in OdeRecord.__struct_fields__ if name != "name"}
        return OdeRecord(name=self.problem.name, **values)

    def blocks(self) -> list[Block]:
        """Return the plan as a document's blocks."""
        from linkplan.studies.output.document import Text

        return [Text(text=f"{self.problem.name}: {self.message}", tone="good" if self.passed else "bad")]
