"""The coordinates in which a motion is stated: if it names other joints than the driven ones, these become independent."""

import json
from collections.abc import Iterator, Mapping

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.equilibrium import sprung_freedoms

# Keys with tables of joint = value in [motion], its waypoints and [reference].
_STATES = ("start", "goal", "start_speed", "goal_speed", "at", "speed", "amplitude", "bias")


def other_coordinates(tables: Mapping[str, dict], mechanism: Mechanism) -> list[str] | None:
    """Return the joints that a motion names and that should be independent; None to keep the mechanism's coordinates.

    The coordinates are kept if the motion names all independent joints, if mechanism.independent is given, or if it names
    more joints than there are degrees of freedom, because it is then unclear which of them follow from the loops.

    Args:
        tables: tables of a problem file.
        mechanism: with its default coordinates.
    """
    if "independent" in mechanism.source:
        return None
    named = [joint.name for joint in mechanism.joints if joint.name in set(_named(tables))]
    resting = {int(mechanism.independent[column]) for column in sprung_freedoms(mechanism)} | set(mechanism.passive_dofs)
    missing = [mechanism.joints[i].name for i in mechanism.independent.tolist() if i not in resting]
    missing = [name for name in missing if name not in named]
    others = set(named) - {joint.name for joint in mechanism.independent_joints}
    return named if missing and others and len(named) <= mechanism.dof else None


def coordinates_note(mechanism: Mechanism, named: list[str]) -> str:
    """Return the note that a motion is planned in the joints that it names."""
    unnamed = [joint.name for joint in mechanism.independent_joints if joint.name not in named]
    return (
        f"the motion names {', '.join(named)} and not {', '.join(unnamed)}: it is planned in these joints"
        f" (mechanism.independent = {json.dumps(named)})"
    )


def _named(tables: Mapping[str, dict]) -> Iterator[str]:
    """Yield the joints that a motion, its waypoints and its reference name."""
    motion = tables.get("motion", {})
    for table in (motion, tables.get("reference", {}), *motion.get("waypoints", [])):
        for state in _STATES:
            for unit in ("deg", "m", "deg_s", "m_s"):
                yield from table.get(f"{state}_{unit}", ())
