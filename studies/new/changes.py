"""What a first motion changes of a model that has none as it is, each with a sentence for the user.

A base that floats is fixed where it stands, since nothing holds it. Joints that weight and springs press onto their stops
are locked there, since a stop's force is not planned for. Of a rod that spins while all else rests, a hinge is locked:
nothing drives the spin, and its equations are too small beside the others for the solver. Dry friction of a robot's leg
sets in over a wider range of speeds: joints that hardly move would have a mesh as fine as the default range asks for. Links
that overlap by construction, as an exporter leaves them on their pins, pass through each other. A drive whose limit is below
the weight at home, as exporters write who do not know the motor, gets twice the effort that holds it.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from linkplan.models.errors import LinkplanError, UnassembledError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.contacts import Meeting, contact_pairs
from linkplan.models.selection import floating_joints
from linkplan.models.tree.coordinates import joint_label
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.studies.check.drives import pressed_joints, sprung_stops
from linkplan.studies.new.pace import is_large

# An effort limit is raised to this multiple of the effort that holds the weight at home: the rest moves the machine.
_HOLD_MULTIPLE = 2.0


def changed_mechanism(table: Mapping[str, object]) -> tuple[Mechanism, tuple[str, ...]]:
    """Return a model's mechanism with what a first motion changes of it, and a sentence on each change.

    Args:
        table: the [mechanism] table.

    Raises:
        ModelError: if the model cannot be used.
    """
    mechanism, notes = _assembled(table), []
    if floats := sorted(floating_joints(mechanism.model)):
        base = ", ".join(dict.fromkeys(mechanism.model.body(int(mechanism.model.jnt_bodyid[j])).name for j in floats))
        joints = ", ".join(joint_label(mechanism.model, j) for j in floats)
        table = dict(table) | {"fix_base": True}
        mechanism = _assembled(table)
        notes.append(
            f"the base {base} floats, and nothing holds it: it is fixed where it stands at home (mechanism.fix_base = true;"
            f" joints {joints})"
        )
    if mechanism.dof and mechanism.n_u and (pressed := _pressed(mechanism)):
        table = _with_locks(table, pressed)
        mechanism = _assembled(table)
        said = ", ".join(f"{name} = {value:g}" for name, value in pressed.items())
        notes.append(
            f"weight and springs press joints onto their stops: they are locked there (mechanism.lock: {said});"
            " a motion on which they would leave their stops is another mechanism's"
        )
    if mechanism.dof and mechanism.n_u and (spins := _spins(mechanism)):
        table = _with_locks(table, spins)
        mechanism = _assembled(table)
        said = ", ".join(f"{name} = {value:g}" for name, value in spins.items())
        notes.append(
            "rods spin while all other joints rest, which nothing drives and which moves nothing else: a hinge of each is"
            f" locked (mechanism.lock: {said})"
        )
    if mechanism.dof and (pairs := _overlapping_at_home(mechanism)):
        table = with_exclusions(table, pairs)
        mechanism = _assembled(table)
        notes.append(overlap_sentence(pairs))
    rubs = max(mechanism.model.dof_frictionloss.max(initial=0.0), mechanism.model.tendon_frictionloss.max(initial=0.0)) > 0
    if rubs and is_large(mechanism) and "friction_transition_deg_s" not in table:
        # With the default of 2 deg/s, xArm's first motion takes 16 s of processor time. With 10 it takes 2 s, and its
        # tracking error doubles.
        default, wide = float(np.degrees(mechanism.friction_transition)), 10.0
        mechanism = _assembled({**table, "friction_transition_deg_s": wide})
        notes.append(
            f"dry friction sets in over {wide:g} deg/s in place of {default:g}, which large mechanisms"
            " need fine meshes for: slow joints are planned with too little of it (mechanism.friction_transition_deg_s)"
        )
    return mechanism, tuple(notes)


def with_exclusions(table: Mapping[str, object], pairs: Sequence[list[str]]) -> dict[str, object]:
    """Return a [mechanism] table that also excludes the contacts of pairs of bodies."""
    given = table.get("exclude_contacts")
    return {**table, "exclude_contacts": [*(given if isinstance(given, list) else []), *pairs]}


def raised_limits(mechanism: Mechanism) -> dict[str, list[float]]:
    """Return effort limits [N.m or N] by actuator, for those that are too weak to hold the weight at home.

    Actuators with the same limits are the same motor, or the same default of an exporter: their limits are raised together.
    """
    still = np.zeros((1, mechanism.dof))
    hold = needed_effort(mechanism, mechanism.home[None], still, still)[0][0]
    limits = [tuple(float(x) for x in ends) for ends in mechanism.effort_limit]
    factors: dict[tuple[float, ...], float] = {}
    for effort, ends in zip(hold, limits, strict=True):
        end = ends[1] if effort > 0 else ends[0]
        if abs(effort) > abs(end) > 0:
            factors[ends] = max(factors.get(ends, 0.0), _HOLD_MULTIPLE * abs(effort) / abs(end))
    return {
        actuator.name: [float(f"{x * factors[ends]:.3g}") for x in ends]
        for actuator, ends in zip(mechanism.actuators, limits, strict=True)
        if ends in factors
    }


def raised_notes(mechanism: Mechanism, tables: Mapping[str, Mapping]) -> list[str]:
    """Return a sentence on the effort limits of a problem's tables that are larger than the model's, if there are some."""
    limits = tables.get("limits", {}).get("effort", {})
    if not limits:
        return []
    said = ", ".join(
        f"{actuator.name} {limits[actuator.name]} in place of {[float(f'{x:.4g}') for x in ends]} {actuator.unit}"
        for actuator, ends in zip(mechanism.actuators, mechanism.effort_limit, strict=True)
        if actuator.name in limits
    )
    return [f"actuators are too weak to hold the weight at home: limits.effort takes {said}; put in the motors' own"]


def overlapping_bodies(contacts: Iterable[Meeting]) -> list[list[str]]:
    """Return the pairs of links that overlap by construction in a plan's contacts; contacts with the world are kept."""
    pairs = dict.fromkeys(meeting.bodies for meeting in contacts if meeting.since is None)
    return [list(pair) for pair in pairs if "world" not in pair]


def overlap_sentence(pairs: Sequence[Sequence[str]]) -> str:
    """Return the sentence on the contacts of overlapping links."""
    return (
        "links overlap at home, or on a pin that they share, and would push each other off in simulation: the contacts of"
        f" {', '.join(f'{first} and {second}' for first, second in pairs)} are excluded (mechanism.exclude_contacts)"
    )


def _overlapping_at_home(mechanism: Mechanism) -> list[list[str]]:
    """Return the pairs of bodies that overlap at home, where a motion may begin; contacts with the world are kept."""
    pairs = dict.fromkeys(pair.bodies for pair in contact_pairs(mechanism, mechanism.home[None]))
    return [list(pair) for pair in pairs if "world" not in pair]


def _pressed(mechanism: Mechanism) -> dict[str, float]:
    """Return the positions [deg or m] of the hinges and slides that rest on their stops, by name."""
    resting = [*pressed_joints(mechanism), *sprung_stops(mechanism)]
    return {joint.name: joint.shown(x) + 0.0 for joint, x in resting if joint.chart is None}


def _spins(mechanism: Mechanism) -> dict[str, float]:
    """Return the home positions [deg or m] of the independent hinges that are passive freedoms, by name."""
    passive = [int(index) for index, steered in zip(mechanism.independent, mechanism.steered, strict=True) if not steered]
    joints = {index: mechanism.joints[index] for index in passive}
    return {
        joint.name: float(f"{joint.shown(mechanism.home[index]):.9g}")
        for index, joint in joints.items()
        if joint.chart is None and joint.kind == "hinge"
    }


def _with_locks(table: Mapping[str, object], locks: Mapping[str, float]) -> dict[str, object]:
    given = table.get("lock")
    return {**table, "lock": {**(given if isinstance(given, Mapping) else {}), **locks}}


def _assembled(table: Mapping[str, object]) -> Mechanism:
    """Return a model's mechanism, assembled at the nearest closed pose if the model's pose is open."""
    tables = {"mechanism": dict(table)}
    try:
        return mechanism_from_tables(tables)
    except UnassembledError as error:
        if not error.home:
            raise
        tables["mechanism"] |= error.home
        try:
            return mechanism_from_tables(tables)
        except LinkplanError:
            raise error from None
