"""The complete result of `linkplan check`: the inspection of a mechanism, and the loop report along its motion or reach."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
from msgspec import UNSET, Struct, UnsetType
from msgspec.structs import asdict, replace

from linkplan.models.errors import LinkplanError
from linkplan.models.foreign.floating import floating_bodies
from linkplan.models.foreign.model_text import urdf_root
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import parameters_of
from linkplan.models.selected_model import whole_model_text
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.files.tables import Tables
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.check_report import largest_forces, path_blocks, pin_table, weight_sentences
from linkplan.studies.check.contacts import StandingPose, standing_blocks, standing_poses
from linkplan.studies.check.drives import joints_to_drive
from linkplan.studies.check.inspection import Inspection, asked_pose, inspect
from linkplan.studies.check.inspection_blocks import inspection_blocks, summary_blocks
from linkplan.studies.check.kinematic_loop_report import (
    KinematicLoopPath,
    Sweep,
    has_whole_records,
    inertia_notes,
    measure,
    measured,
    motion_path,
    reach_sweeps,
)
from linkplan.studies.check.path_plots import MAX_COORDINATES_DRAWN, over, path_plots, rising_order
from linkplan.studies.check.path_quantities import PathFigures, path_figures
from linkplan.studies.check.refused_model import REFUSED, CheckResult
from linkplan.studies.check.site_statics import (
    SiteStatics,
    checked_forces,
    site_statics,
    statics_blocks,
    statics_plots,
)
from linkplan.studies.check.tolerances import (
    Tolerances,
    tolerance_blocks,
    tolerance_plots,
    tolerances_along,
    with_tolerances,
)
from linkplan.studies.output.animation import animation, frames_of
from linkplan.studies.output.document import Block, Section, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec, one_screen

# Pins in the table of a summary.
MOST_PINS = 6


class NamedNumber(Struct, frozen=True, kw_only=True):
    """A number of a model that can be a parameter, in SI."""

    name: str
    value: float
    unit: str


class WholeCheck(CheckResult, Inspection, frozen=True, kw_only=True, eq=False, dict=True):
    """An inspection, and the loop report along a problem's motion or, without one, over each coordinate's reach."""

    along: Sequence[PathFigures] | UnsetType = UNSET
    sites: Sequence[SiteStatics] | UnsetType = UNSET
    parameters: Sequence[NamedNumber] | UnsetType = UNSET
    tolerances: Sequence[Tolerances] | UnsetType = UNSET
    contacts_at_rest: Sequence[StandingPose] | UnsetType = UNSET
    sweeps: Beside[tuple[Sweep, ...]] = NOT_READ

    @property
    def paths(self) -> Iterable[KinematicLoopPath]:
        """The loop report along the motion, or along each sweep; a summary of many coordinates needs none.

        The size of a report grows with the square of the number of coordinates, so reports of many coordinates are not kept.
        """
        return map(measured, self.sweeps) if self.brief else self._few_paths

    @cached_property  # measured once, at first use; the cache needs dict=True
    def _few_paths(self) -> tuple[KinematicLoopPath, ...]:
        return tuple(map(measured, self.sweeps))

    @property
    def brief(self) -> bool:
        """Tell if there are so many coordinates that each is reported in brief."""
        return len(self.sweeps) > 6

    @property
    def struct(self) -> "WholeCheck":
        """The check with the quantities along every path, whose measurement takes time and memory."""
        return replace(self, along=[path_figures(path) for path in self.paths])

    @property
    def joints_to_drive(self) -> tuple[str, ...]:
        """For a mechanism without an actuator, the joints that motors could drive."""
        return () if self.mechanism.n_u else tuple(joints_to_drive(self.mechanism))

    @property
    def floats(self) -> bool:
        """Whether a body of the model floats freely."""
        return bool(floating_bodies(self.mechanism.model)[0])

    def blocks(self) -> list[Block]:
        """Return the findings as a document, with brief tables for more than six coordinates."""
        brief = self.brief
        found = [(path_blocks(path, brief=brief), largest_forces(path)) for path in self.paths]
        paths = [*(block for blocks, _ in found for block in blocks), *pin_table(forces for _, forces in found)]
        rest = "all of them" if has_whole_records(self.mechanism) else "every pose"
        left_out = (
            f"the table of each of the {len(self.sweeps)} coordinates above has only its own quantities that change along"
            f" its reach, at rest; the JSON record has {rest}"
        )
        return [*inspection_blocks(self), *paths, *([Text(text=left_out)] if brief else []), *self._site_blocks()]

    def _site_blocks(self) -> list[Block]:
        found = [block for site in self.sites or () for block in statics_blocks(site)]
        found += standing_blocks(self.contacts_at_rest) if self.contacts_at_rest else []
        found += [block for errors in self.tolerances or () for block in tolerance_blocks(errors)]
        if self.parameters:
            rows = [[one.name, one.value, one.unit] for one in self.parameters]
            found.append(
                table_of("Numbers of the model for [parameters]", [("name", ""), ("value", ""), ("unit", "")], rows)
            )
        return found

    def summary(self) -> list[Block]:
        """Return the findings in at most thirty lines; first the notes on actuators too weak for weight and springs."""
        few = () if self.brief else self.paths
        weak = [text for path in few for text in weight_sentences(path)]
        pins = pin_table(map(largest_forces, few), MOST_PINS)
        return [*summary_blocks(replace(self, notes=(*weak, *self.notes))), *pins, *self._site_blocks()]

    def sections(self) -> list[Section]:
        """Return the sections of the findings and of each path."""
        first = Section(title=f"Mechanism: {self.name}", blocks=inspection_blocks(self))
        found = [first, *(path_section(path, self.name, len(self.sweeps)) for path in self.paths)]
        for site in self.sites or ():
            blocks = [*statics_blocks(site), *statics_plots(site)]
            found.append(Section(title=f"Site {site.site} along {site.path}", blocks=blocks, depth=2))
        for errors in self.tolerances or ():
            blocks = [*tolerance_blocks(errors), *tolerance_plots(errors)]
            found.append(Section(title=f"Tolerances along {errors.path}", blocks=blocks, depth=2))
        return found

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the figures over the reach and along each path."""
        from linkplan.studies.check.path_plots import MAX_FIGURES, inspection_figure, path_figure

        yield "mechanism", inspection_figure(self)
        for number, path in enumerate(self.paths if len(self.sweeps) <= MAX_FIGURES else (), 1):
            yield f"loop-{number}", path_figure(path, self.reaches)
        panels = [plot for site in self.sites or () for plot in statics_plots(site)]
        if panels:
            title = f"{self.name}: what sites do for an effort, at rest"
            yield "sites", FigureSpec(panels=panels, title=title, columns=2, panel_in=one_screen(len(panels), 2, (6.0, 3.3)))

        panels = [plot for errors in self.tolerances or () for plot in tolerance_plots(errors)]
        if panels:
            title = f"{self.name}: errors by tolerances"
            size = one_screen(len(panels), 2, (6.0, 3.3))
            yield "tolerances", FigureSpec(panels=panels, title=title, columns=2, panel_in=size)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write the model as it was read, if it differs from the file."""
        del parquet
        mechanism = self.mechanism
        changed = mechanism.selection or mechanism.shifted or "parameters" in mechanism.source
        if changed or urdf_root(str(mechanism.source["model"])) is not None:
            written = "selected.xml" if mechanism.selection else "model.xml"
            (place / written).write_text(whole_model_text(mechanism), encoding="utf-8")


def mechanism_and_problem(
    name: str, tables: Tables, folder: Path | None
) -> tuple[Mechanism, Problem | None, tuple[str, ...]]:
    """Return the mechanism of a problem file, its problem if it has one, and the reasons why it cannot be planned.

    Raises:
        LinkplanError: if the mechanism itself is invalid; one of REFUSED if its model is refused.
    """
    if "motion" not in tables:
        return mechanism_from_tables(tables, folder), None, ()
    try:
        problem = Problem.from_tables(name, tables, folder)
    except REFUSED:
        raise
    except LinkplanError as error:
        return mechanism_from_tables(tables, folder), None, (f"the problem cannot be planned: {error}",)
    return problem.mechanism, problem, ()


def check_whole(
    mechanism: Mechanism,
    problem: Problem | None,
    poses: Sequence[dict[str, float]] = (),
    notes: Sequence[str] = (),
    site_forces: Mapping[str, Sequence[float]] | None = None,
    tolerances: Mapping[str, float] | None = None,
    *,
    with_parameters: bool = False,
    phases: PhasedProblem | None = None,
) -> WholeCheck:
    """Return the check of a mechanism, along its problem's motion if there is a problem.

    Args:
        mechanism: that of the problem, if there is one.
        problem: with the motion and the contact setting.
        poses: joint positions [rad or m] by name, each with a report.
        notes: further sentences for the report.
        site_forces: forces (3,) [N] that act on sites, one at a time, with the statics of all sites; None leaves them out.
        tolerances: of numbers of the model [SI] by name or pattern, with those of the problem; None leaves errors out.
        with_parameters: whether the numbers of the model that can be parameters are listed.
        phases: the motion in phases whose contacts are examined; None without.

    Raises:
        ProblemError: if a pose is out of reach or names a dependent joint, or a force is on no site.
    """
    motion, off_path = _motion(problem)
    judged, stands = "refuse" if problem is None else problem.limits.contacts, phases is not None
    found = inspect(mechanism, list(poses), motion=motion, contacts=judged, on_ground=stands)
    along = reach_sweeps(mechanism, found.reaches) if motion is None else (motion,)
    chosen = () if problem is None else problem.notes
    singular = [note for path in along for note in inertia_notes(path)]
    notes = (*found.notes, *singular, *notes, *chosen, *off_path)
    sites = errors = UNSET
    if site_forces is not None:
        forces = checked_forces(mechanism, site_forces)
        sites = [site for path in _measured(mechanism, along, poses) for site in site_statics(path, forces)]
    if tolerances is not None:
        machine, largest = with_tolerances(mechanism, tolerances, {} if problem is None else problem.tolerances)
        errors = [tolerances_along(path, machine, largest) for path in _measured(mechanism, along, poses)]
    numbers = UNSET
    if with_parameters:
        every = parameters_of(mechanism.model).values()
        numbers = [NamedNumber(name=one.name, value=one.value, unit=one.unit) for one in every]
    contacts = UNSET if phases is None else standing_poses(phases)
    further = {"sites": sites, "tolerances": errors, "parameters": numbers, "contacts_at_rest": contacts}
    return WholeCheck(**asdict(replace(found, notes=notes)), sweeps=along, **further)


def _measured(mechanism: Mechanism, along: Sequence[Sweep], poses: Sequence[dict[str, float]]) -> list[KinematicLoopPath]:
    """Return the loop reports along each path, and at the poses asked for."""
    paths = [measured(sweep) for sweep in along]
    if poses:
        paths.append(measure(mechanism, np.array([asked_pose(mechanism, asked) for asked in poses]), "the poses asked for"))
    return paths


def _motion(problem: Problem | None) -> tuple[KinematicLoopPath | None, tuple[str, ...]]:
    """Return the path of a problem's motion, or None with the reason."""
    if problem is None:
        return None, ()
    try:
        return motion_path(problem), ()
    except LinkplanError as error:
        return None, (f"no path for the problem's motion: {error}",)


def path_section(path: KinematicLoopPath, name: str, of: int) -> Section:
    """Return the section of one `of` several paths: an animation, a table, plots of ratios, inertias, efforts and forces."""
    axis, x = over(path)
    group = f"path:{name}:{path.title}"
    order = rising_order(x)
    most = frames_of(path.mechanism, of)
    frames = order[np.unique(np.linspace(0, len(order) - 1, min(len(order), most)).astype(int))]
    moving = animation(
        path.mechanism,
        f"{name} along {path.title}",
        group,
        x[frames],
        path.poses[frames],
        effort=path.holding_effort[frames],
        effort_limit=path.limit,
        unit=axis.unit,
    )
    blocks = [moving, *path_blocks(path), *path_plots(path, group)]
    return Section(title=f"Along {path.title}, at rest", blocks=blocks, depth=2, folded=of > MAX_COORDINATES_DRAWN)
