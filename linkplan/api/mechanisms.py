"""`load_mechanism` and `check`: from an MJCF model to an assembled mechanism, and a report on it before planning."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.api.command import command
from linkplan.api.inputs import Poses, Source, Subject, poses_of, source_of, subject_of
from linkplan.api.paths import check_flags
from linkplan.api.results import Result
from linkplan.models.foreign.floating import floating_bodies
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.check.refused_model import REFUSED, RefusedModel, refused_model
from linkplan.studies.output.document import Block, Report

if TYPE_CHECKING:
    from msgspec import Struct

    from linkplan.studies.check.whole_check import WholeCheck
    from linkplan.studies.output.figure_spec import FigureSpec


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
    force: Mapping[str, Sequence[float]] | None = None,
    gear: Mapping[str, float] | None = None,
    rotor_inertia: Mapping[str, float] | None = None,
    effort_sharing: str | None = None,
    pre_tension: Mapping[str, float] | None = None,
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
        solref: "stiff" for the stiffest closures in simulation that the model's timestep permits; by default those of the
            model.
        closure_tolerance_m: a motion that opens the loops by less than this [m] counts as free, because only rounded numbers
            in the file prevent it; by default 1e-6 m, or 1e-5 of a small mechanism's size.
        friction_transition_deg_s: the speed v_0 of the dry friction f tanh(v / v_0); by default 2. For slides and tendons,
            this speed in rad/s is multiplied by the mechanism's extent.
        keep: names of the only bodies or joints of a larger robot to read, with everything attached to them and their loops.
            The bodies between them and the world are read, too. `notes` names what was dropped.
        fix_base: whether the joints between the world and the kept bodies, and a base without actuators, are locked.
        lock: joints to lock at an angle [deg], or slides at a position [m], in addition to a file's locks.
        keyframe: the model's keyframe that gives the home pose and the pose of a fixed base; by default "home".
        exclude_contacts: pairs of names of bodies whose geoms pass through each other.
        drive: names of joints that get a motor, within the joint's effort limit; many URDFs define no motors.
        lock_spin: names of ball joints of rods that must not spin about their own line; each becomes a universal joint.
        force: constant forces (3,) [N] in the world's axes by site: a load on a foot, a weight on a hook.
        gear: gears of motors by actuator, in place of the model's: the motor's position over that of its joint.
        rotor_inertia: inertia of the motors' rotors [kg m2, or kg] by actuator, before the gear.
        effort_sharing: how more actuators than degrees of freedom share an effort outside the optimiser, always within their
            limits: "least_squares" (the default) or "least_peak".
        pre_tension: efforts [N or N.m] by actuator, nearest to which they do so; by default 0.

    Raises:
        LinkplanError: if the model cannot be used (`ModelError`), its loops do not close at the given pose
            (`AssemblyError`), or a value is invalid (`ProblemError`).

    Example::

        knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    """
    check_flags(fix_base=fix_base)
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
        "force": force,
        "gear": gear,
        "rotor_inertia": rotor_inertia,
        "effort_sharing": effort_sharing,
        "pre_tension": pre_tension,
    }
    table = {"model": path_or_name} | {key: value for key, value in said.items() if value is not None}
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
