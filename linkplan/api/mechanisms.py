"""`load_mechanism` and `check`: from an MJCF model to an assembled mechanism, and a report on it before planning."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from linkplan.api.command import command
from linkplan.api.inputs import Poses, Source, Subject, poses_of, source_of, subject_of
from linkplan.models.foreign.floating import floating_bodies
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.build import MECHANISM_ARGUMENTS, mechanism_from_tables, with_arguments
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.check.refused_model import REFUSED, RefusedModel, refused_model
from linkplan.studies.output.document import Block, Report
from linkplan.studies.output.result import Result

if TYPE_CHECKING:
    from msgspec import Struct

    from linkplan.studies.check.whole_check import WholeCheck
    from linkplan.studies.output.figure_spec import FigureSpec


@functools.partial(with_arguments, names=MECHANISM_ARGUMENTS)
def load_mechanism(path_or_name: str | Path, **keys: Any) -> Mechanism:
    """Return the mechanism of a built-in name (listed by `linkplan list`), an MJCF file or MJCF text, with closed loops.

    The arguments are keys of [mechanism] in problem files.

    Raises:
        LinkplanError: if the model cannot be used (`ModelError`), its loops do not close at the given pose
            (`AssemblyError`), or a value is invalid (`ProblemError`).

    Example::

        knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    """
    table = {key: value for key, value in keys.items() if value is not None} | {"model": path_or_name}
    return mechanism_from_tables({"mechanism": to_toml_types(table)})


@command(
    "report on a mechanism: degrees of freedom, closure, reach, singular poses, ratios, inertias, forces, faults",
    record="check",
    showing=("all", "report"),
)
def check(subject: Subject, *, at_deg: Poses = (), at_m: Poses = ()) -> CheckResult:
    """Return the report on a mechanism before planning, along the motion of a problem if one is given.

    A model that is locked or not assembled also has a report, with the reason in `problems`. If a problem file cannot be
    planned, the report is about its mechanism, with the reason in `notes`.

    Args:
        subject: a mechanism, a `Problem`, or the name or path of either.
        at_deg: further poses for the report, each the independent hinges' angles [deg] by joint name, or a number for the
            only joint.
        at_m: likewise, for slides [m].

    Raises:
        LinkplanError: if a pose is out of reach, or the subject cannot be read.

    Example::

        found = linkplan.check("optimus-knee")
        print(found.problems, found)
    """
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    notes: tuple[str, ...] = ()
    try:
        if isinstance(subject, Source | str | Path) and source_of(subject).is_problem:
            mechanism, problem, notes = mechanism_and_problem(*source_of(subject).tables())
        else:
            mechanism, problem = subject_of(subject)
    except REFUSED as error:
        text = source_of(subject).name if isinstance(subject, Source | str | Path) else str(subject)
        return CheckResult(found=refused_model("the model" if "<" in text else Path(text).stem, error))
    return CheckResult(found=check_whole(mechanism, problem, poses_of(mechanism, at_deg, at_m), notes))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class CheckResult(Result):
    """The findings of `check`. `str(result)` is the report; `to_dict()` has every value, with units in the names."""

    record_name = "check"
    found: WholeCheck | RefusedModel

    @property
    def problems(self) -> tuple[str, ...]:
        """The faults, each a sentence; empty for a mechanism without faults."""
        return self.found.problems

    @property
    def notes(self) -> tuple[str, ...]:
        """Findings that are not faults, each a sentence."""
        return self.found.notes

    @property
    def passed(self) -> bool:
        """Whether there are no faults."""
        return not self.problems

    @property
    def mechanism(self) -> Mechanism | None:
        """The mechanism; None for a model that is refused."""
        return getattr(self.found, "mechanism", None)

    @property
    def home(self) -> dict:
        """The nearest closed pose of a refused model whose own pose does not close, as tables home_deg and home_m."""
        return getattr(getattr(self.found, "error", None), "home", {})

    @property
    def joints_to_drive(self) -> tuple[str, ...]:
        """For a mechanism without an actuator, the joints that motors could drive."""
        from linkplan.studies.check.drives import joints_to_drive

        return () if self.mechanism is None or self.mechanism.n_u else tuple(joints_to_drive(self.mechanism))

    @property
    def floats(self) -> bool:
        """Whether a body of the model floats freely."""
        return self.mechanism is not None and bool(floating_bodies(self.mechanism.model)[0])

    @property
    def struct(self) -> Struct:
        """The findings and the quantities along each path."""
        return getattr(self.found, "with_paths", self.found)

    def blocks(self) -> list[Block]:
        """Return every finding and table."""
        return self.found.blocks()

    def summary(self) -> list[Block]:
        """Return a summary of the findings in at most thirty lines."""
        return self.found.summary()

    def document(self) -> Report:
        """Return the report."""
        from linkplan.studies.check.check_sections import check_report

        return check_report(self.found)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the figures over the reach and along each path; none if the model is not a valid mechanism."""
        from linkplan.studies.check.path_plots import MAX_FIGURES, inspection_figure, path_figure

        if isinstance(self.found, RefusedModel):
            return
        yield "mechanism", inspection_figure(self.found)
        for number, path in enumerate(self.found.paths if len(self.found.sweeps) <= MAX_FIGURES else (), 1):
            yield f"loop-{number}", path_figure(path, self.found.reaches)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write the model as it was read, if it differs from the file."""
        from linkplan.models.foreign.model_text import urdf_root
        from linkplan.models.selected_model import whole_model_text

        del parquet
        mechanism = self.mechanism
        if mechanism is None:
            return
        if mechanism.selection or mechanism.shifted or urdf_root(str(mechanism.source["model"])) is not None:
            written = "selected.xml" if mechanism.selection else "model.xml"
            (place / written).write_text(whole_model_text(mechanism), encoding="utf-8")

    def __repr__(self) -> str:
        return f"CheckResult({self.found.name!r}, {len(self.problems)} problems, {len(self.notes)} notes)"
