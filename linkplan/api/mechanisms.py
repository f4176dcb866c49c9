"""`load_mechanism` and `check`: from an MJCF model to an assembled mechanism, and a report on it before planning."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from linkplan.api.command import command
from linkplan.api.inputs import (
    ByParameter,
    Poses,
    SiteForces,
    Source,
    Subject,
    given_phases,
    poses_of,
    source_of,
    subject_of,
)
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.build import MECHANISM_ARGUMENTS, mechanism_from_tables, with_arguments
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.check.refused_model import REFUSED, RefusedModel, refused_model

if TYPE_CHECKING:
    from linkplan.studies.check.whole_check import WholeCheck


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
    saved=True,
    showing=("all", "report"),
)
def check(
    subject: Subject | PhasedProblem,
    *,
    at_deg: Poses = (),
    at_m: Poses = (),
    sites: bool = False,
    site_force_n: SiteForces | None = None,
    parameters: bool = False,
    tolerances: bool = False,
    tolerance: ByParameter | None = None,
) -> WholeCheck | RefusedModel:
    """Return the report on a mechanism before planning, along the motion of a problem if one is given.

    A model that is locked or not assembled also has a report, with the reason in `problems`. If a problem file cannot be
    planned, the report is about its mechanism, with the reason in `notes`. That of a motion in phases says whether the
    contacts of each phase can hold the poses at its start and end, and with which forces.

    Args:
        subject: a mechanism, a `Problem`, a motion in phases, or the name or path of either.
        at_deg: further poses for the report, each the independent hinges' angles [deg] by joint name, or a number for the
            only joint.
        at_m: likewise, for slides [m].
        sites: what each site does for an effort, and an effort for it: its rate per motor, efforts per newton, largest
            pushes, reflected mass and stiffness over the reach and at the further poses.
        site_force_n: forces x, y, z [N] by site, one at a time, with the efforts that hold each of them; implies `sites`.
        parameters: the numbers of the model that have names, with values and units: those that [parameters] can set.
        tolerances: errors of sites, dependent joints, ratios and holding efforts by the tolerances of [parameters]: worst
            case, standard deviation, causes.
        tolerance: tolerances [SI] by number, or by a pattern of names: "*.length=1e-4" is every link; implies `tolerances`.

    Raises:
        LinkplanError: if a pose is out of reach, a site is not in the model, or the subject cannot be read.

    Example::

        found = linkplan.check("optimus-knee")
        print(found.problems, found)
    """
    from linkplan.studies.check.whole_check import check_whole, mechanism_and_problem

    notes: tuple[str, ...] = ()
    try:
        phases = given_phases(subject)
        if phases is not None:
            mechanism, problem = phases.bare_mechanism(0), None
        elif isinstance(subject, Source | str | Path) and source_of(subject).is_problem:
            mechanism, problem, notes = mechanism_and_problem(*source_of(subject).tables())
        else:
            mechanism, problem = subject_of(cast("Subject", subject))
    except REFUSED as error:
        text = source_of(subject).name if isinstance(subject, Source | str | Path) else str(subject)
        return refused_model("the model" if "<" in text else Path(text).stem, error)
    return check_whole(
        mechanism,
        problem,
        poses_of(mechanism, at_deg, at_m),
        notes,
        site_force_n if site_force_n or not sites else {},
        tolerance if tolerance or not tolerances else {},
        with_parameters=parameters,
        phases=phases,
    )
