"""`load_mechanism` and `check`: from an MJCF model to an assembled mechanism, and what is to be known before planning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.paths import drawn
from linkplan.plain import plain
from linkplan.planner.files.problem_file import mechanism_from_tables
from linkplan.planner.files.tables import read_tables
from linkplan.subjects import Subject, is_problem, poses_of, subject_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from linkplan.studies.check.refused_model import RefusedModel
    from linkplan.studies.check.whole_check import WholeCheck


def load_mechanism(
    path_or_name: str | Path,
    *,
    home_deg: Mapping[str, float] | None = None,
    home_m: Mapping[str, float] | None = None,
    independent: Sequence[str] | None = None,
    payload: str | Mapping | None = None,
    solref: str | None = None,
    closure_tolerance_m: float | None = None,
    friction_transition_deg_s: float | None = None,
) -> Mechanism:
    """Return the mechanism of a built-in name, an MJCF file or MJCF text, its loops closed.

    Args:
        path_or_name: a built-in name (`linkplan list` has them), a path to an MJCF file, or MJCF text.
        home_deg: hinges' angles [deg] by joint name at which to assemble: independent joints are held there, the others
            choose the branch. By default the model's keyframe "home", else its reference pose.
        home_m: slides' positions [m], likewise.
        independent: names of the joints to plan in; by default the driven ones.
        payload: a rigid body welded on: a built-in name ("shank"), or a table with `body`, `mass_kg`, `com_m` (3 numbers
            in the body's frame) and, where it is known, `inertia_kgm2` (3 moments about its centre of mass).
        solref: "stiff" for the stiffest closures in simulation that the model's timestep admits; by default the model's own.
        closure_tolerance_m: the gap [m] up to which a motion that the file's rounding alone forbids is free; a micrometre
            by default, or a hundred thousandth of a small mechanism.
        friction_transition_deg_s: the speed v_0 about which dry friction f tanh(v / v_0) turns over; 2 by default. On
            slides and tendons as many rad/s times the mechanism's size.

    Raises:
        LinkplanError: when the model cannot be used (`ModelError`, naming why), its loops do not close at the pose asked
            (`AssemblyError`), or a value is none of the above (`ProblemError`).
    """
    said = {"home_deg": home_deg, "home_m": home_m, "independent": independent, "payload": payload, "solref": solref}
    said["closure_tolerance_m"] = closure_tolerance_m
    said["friction_transition_deg_s"] = friction_transition_deg_s
    table = {"model": path_or_name} | {key: value for key, value in said.items() if value is not None}
    return mechanism_from_tables({"mechanism": plain(table)})


def check(
    subject: Subject, *, at_deg: Sequence[Mapping[str, float]] = (), at_m: Sequence[Mapping[str, float]] = ()
) -> CheckResult:
    """Return what is to be known of a mechanism before planning, along a problem's motion where one is given.

    A model that is no mechanism as it stands, locked or not assembled, is reported on too: `problems` says why. So is the
    mechanism of a problem file that cannot be planned, and `notes` says why not.

    Args:
        subject: a mechanism, a `Problem`, or the name or path of either.
        at_deg: poses to report on besides, each independent hinges' angles [deg] by joint name.
        at_m: the same of slides [m].

    Raises:
        LinkplanError: for a pose that is beyond reach, or a subject that cannot be read.
    """
    from linkplan.studies.check.refused_model import REFUSED, RefusedModel
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    notes: tuple[str, ...] = ()
    try:
        if isinstance(subject, str | Path) and is_problem(subject):
            mechanism, planning, notes = mechanism_and_problem(*read_tables(subject))
        else:
            mechanism, problem = subject_of(subject)
            planning = None if problem is None else problem.planning
    except REFUSED as error:
        text = str(subject)
        return CheckResult(found=RefusedModel(name="the model" if "<" in text else Path(text).stem, error=error))
    return CheckResult(found=check_whole(mechanism, planning, poses_of(mechanism, at_deg, at_m), notes))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class CheckResult:
    """What `check` found. `str(result)` is the report; `to_dict()` has every figure, its unit in its name."""

    found: WholeCheck | RefusedModel

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong, each in a sentence; empty for a mechanism that is fit to plan with."""
        return self.found.problems

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth knowing but no fault, each in a sentence."""
        return self.found.notes

    def to_dict(self) -> dict:
        """Return all figures by name, in JSON's own types."""
        from linkplan.planner.files.folders import plain_record

        return plain_record(self.found.record())

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of the mechanism over its reach; it is saved at `path` where one is given.

        Raises:
            LinkplanError: when the model is no mechanism as it stands.
        """
        from linkplan.studies.check.draw_mechanism import inspection_figure
        from linkplan.studies.check.refused_model import RefusedModel

        if isinstance(self.found, RefusedModel):
            raise LinkplanError(f"nothing to draw: {self.found.error}")
        found = self.found.found
        return drawn(path, lambda place: inspection_figure(found, place))

    def __str__(self) -> str:
        return self.found.text()

    def __repr__(self) -> str:
        return f"CheckResult({self.found.name!r}, {len(self.problems)} problems, {len(self.notes)} notes)"
