"""`load_mechanism` and `check`: from an MJCF model to an assembled mechanism, and a report on it before planning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism
from linkplan.paths import drawn
from linkplan.planner.files.folders import plain_record
from linkplan.planner.files.tables import read_tables
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.settings import plain
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
    keep: Sequence[str] | None = None,
    fix_base: bool = False,
    lock: Mapping[str, float] | None = None,
    keyframe: str | None = None,
    exclude_contacts: Sequence[Sequence[str]] = (),
    drive: Sequence[str] | None = None,
    lock_spin: Sequence[str] | None = None,
) -> Mechanism:
    """Return the mechanism of a built-in name, an MJCF file or MJCF text, with closed loops.

    Args:
        path_or_name: a built-in name (listed by `linkplan list`), a path to an MJCF file, or MJCF text.
        home_deg: hinges' angles [deg] by joint name for the assembly: independent joints are held there, the others choose
            the branch. By default the model's keyframe "home", else its reference pose.
        home_m: likewise, slides' positions [m].
        independent: names of the independent joints; by default the driven joints.
        payload: a rigid body welded on: a built-in name ("shank"), or a table with `body`, `mass_kg`, `com_m` (3 numbers
            in the body's frame) and, if it is known, `inertia_kgm2` (3 moments about its centre of mass).
        solref: "stiff" for the stiffest closures in simulation that the model's timestep admits; by default those of the
            model.
        closure_tolerance_m: a motion that opens the loops by less than this [m] counts as free, because only rounding in the
            file forbids it; by default a micrometre, or a hundred thousandth of a small mechanism.
        friction_transition_deg_s: the speed v_0 of the dry friction f tanh(v / v_0); by default 2. For slides and tendons,
            this speed in rad/s is multiplied by the mechanism's extent.
        keep: names of bodies or joints: of a larger robot, only these bodies are read, with what hangs on them, the chains
            that close loops over them, and the bodies between them and the world. `notes` names what was dropped.
        fix_base: True locks what lies between the world and the kept bodies, and a base that no actuator moves.
        lock: positions by name of joints that do not move, in degrees on hinges and in metres on slides.
        keyframe: the model's keyframe that gives the home pose and the pose of a fixed base; by default "home".
        exclude_contacts: pairs of names of bodies whose geoms pass through each other.
        drive: names of joints that get a motor, within the effort limit that the joint has; a URDF often names none.
        lock_spin: names of ball joints of rods that do not spin about their own line: universal joints take their places.

    Raises:
        LinkplanError: if the model cannot be used (`ModelError`), its loops do not close at the given pose
            (`AssemblyError`), or a value is invalid (`ProblemError`).

    Example::

        knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    """
    said = {"home_deg": home_deg, "home_m": home_m, "independent": independent, "payload": payload, "solref": solref}
    said["closure_tolerance_m"] = closure_tolerance_m
    said["friction_transition_deg_s"] = friction_transition_deg_s
    said |= {
        "keep": keep,
        "fix_base": fix_base or None,
        "lock": lock,
        "keyframe": keyframe,
        "exclude_contacts": exclude_contacts or None,
        "drive": drive,
        "lock_spin": lock_spin,
    }
    table = {"model": path_or_name} | {key: value for key, value in said.items() if value is not None}
    return mechanism_from_tables({"mechanism": plain(table)})


def check(
    subject: Subject, *, at_deg: Sequence[Mapping[str, float]] = (), at_m: Sequence[Mapping[str, float]] = ()
) -> CheckResult:
    """Return the report on a mechanism before planning, along the motion of a problem if one is given.

    A model that is locked or not assembled has a report, too, with the reason in `problems`. For a problem file that cannot
    be planned, the report is on its mechanism, with the reason in `notes`.

    Args:
        subject: a mechanism, a `Problem`, or the name or path of either.
        at_deg: further poses for the report, each the independent hinges' angles [deg] by joint name.
        at_m: likewise, for slides [m].

    Raises:
        LinkplanError: if a pose is out of reach, or the subject cannot be read.

    Example::

        found = linkplan.check("optimus-knee")
        print(found.problems, found)
    """
    from linkplan.studies.check.refused_model import REFUSED, RefusedModel
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    notes: tuple[str, ...] = ()
    try:
        if isinstance(subject, str | Path) and is_problem(subject):
            mechanism, problem, notes = mechanism_and_problem(*read_tables(subject))
        else:
            mechanism, problem = subject_of(subject)
    except REFUSED as error:
        text = str(subject)
        return CheckResult(found=RefusedModel(name="the model" if "<" in text else Path(text).stem, error=error))
    return CheckResult(found=check_whole(mechanism, problem, poses_of(mechanism, at_deg, at_m), notes))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class CheckResult:
    """The findings of `check`. `str(result)` is the report; `to_dict()` has every value, with units in the names."""

    found: WholeCheck | RefusedModel

    @property
    def problems(self) -> tuple[str, ...]:
        """The faults, each a sentence; empty for a mechanism without faults."""
        return self.found.problems

    @property
    def notes(self) -> tuple[str, ...]:
        """Further facts that are no faults, each a sentence."""
        return self.found.notes

    def to_dict(self) -> dict:
        """Return all values by name, in JSON types."""
        return plain_record(self.found.record())

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of the mechanism over its reach, saved at `path` if it is given.

        Raises:
            LinkplanError: if the model is not a valid mechanism.
        """
        from linkplan.studies.check.path_plots import inspection_figure
        from linkplan.studies.check.refused_model import RefusedModel

        if isinstance(self.found, RefusedModel):
            raise LinkplanError(f"nothing to draw: {self.found.error}")
        found = self.found.found
        return drawn(path, lambda place: inspection_figure(found, place))

    def _repr_html_(self) -> str:
        from linkplan.studies.output.text import html_of

        return html_of(self.found.blocks())

    def __str__(self) -> str:
        from linkplan.studies.output.text import text_of

        return text_of(self.found.blocks())

    def __repr__(self) -> str:
        return f"CheckResult({self.found.name!r}, {len(self.problems)} problems, {len(self.notes)} notes)"
