"""The changes that make a first motion of a model possible, each with a sentence for the user.

A base that floats is fixed where it stands, since nothing holds it. Joints that weight and springs press onto their
stops are locked there, since a stop's force is not planned for, and so are joints that their own ranges fix, or that
nothing drives and dry friction holds. Of a rod that spins while all else rests, a hinge is locked: nothing drives the
spin, and its equations are too small beside the others for the solver. Of a rod between ball joints, a universal joint
takes the place of one. Dry friction of a robot's leg sets in over a wider range of speeds: joints that hardly move would
have a mesh as fine as the default range asks for. Links that overlap by construction, as an exporter leaves them on
their pins, pass through each other. A drive whose limit is below the weight at home gets twice the effort that holds it:
exporters often write a placeholder.
"""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence

import mujoco
import numpy as np

from linkplan.models.actuation.actuators import label
from linkplan.models.audit import audit
from linkplan.models.errors import LinkplanError, UnassembledError, listed
from linkplan.models.foreign.floating import floating_joints, floating_words
from linkplan.models.foreign.urdf_loops import FILTERS
from linkplan.models.kinematics import STIFF
from linkplan.models.library import compile_model
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.contacts import Contact, ContactPair, contact_pairs
from linkplan.models.tree.coordinates import joint_label
from linkplan.planner.problem.build import mechanism_from_tables, model_from_tables
from linkplan.studies.check.inspection_blocks import grouped
from linkplan.studies.check.new.hanging import is_large
from linkplan.studies.check.new.locks import (
    HOLD_MULTIPLE,
    dropped,
    fixed_by_range,
    held_by_friction,
    pressed,
    rods_on_balls,
    spins,
)
from linkplan.studies.check.softness import SOFT_GAP, STIFF_KEY, home_gap

# Keys of the [mechanism] table that a change sets, and its sentence.
Change = tuple[dict[str, object], str]


def changed_mechanism(table: Mapping[str, object]) -> tuple[Mechanism, tuple[str, ...]]:
    """Return a model's mechanism with the changes for a first motion, and a sentence on each change.

    Args:
        table: the [mechanism] table.

    Raises:
        ModelError: if the model cannot be used.
    """
    source, selection = model_from_tables({"mechanism": dict(table)})
    notes = []
    if not selection.fix_base:
        model = compile_model(source, selection=selection)[1]
        floats = sorted(floating_joints(model))
        if 0 < len(floats) < model.njnt:
            table, joints = {**table, "fix_base": True}, listed([joint_label(model, j) for j in floats], 4)
            fixed = f"fixed in place at home (mechanism.fix_base = true; joints {joints})"
            notes.append(f"{floating_words(model)}: {fixed}")
    mechanism = _assembled(table)
    for change in _CHANGES:
        if (changed := change(mechanism, table)) is not None:
            keys, note = changed
            table = {**table, **keys}
            mechanism = _assembled(table, mechanism)
            notes.append(note)
    # MuJoCo scales the stiffness of a loop by the inertia of its bodies, so links without mass do not hold a loop.
    if "solref" not in table and home_gap(mechanism) > SOFT_GAP:
        mechanism = _assembled({**table, "solref": STIFF}, mechanism)
        notes.append(
            "in simulation, the model's loops would open by more than 1 % of its size, or 0.01 rad, under its weight: they"
            f" are made as stiff as the timestep permits ({STIFF_KEY}) and open by {home_gap(mechanism):.1g} of its"
            " size or rad"
        )
    if moved := sorted(mechanism.source.keys() & {"home_deg", "home_m"} - table.keys()):
        notes.append(
            "the loops are open or singular at the model's own pose: home is the nearest closed pose found, on one of the"
            f" branches that meet there ({' and '.join(f'mechanism.{key}' for key in moved)})"
        )
    return mechanism, (*notes, *mechanism.faults)


def _ball_rods_locked(mechanism: Mechanism, table: Mapping[str, object]) -> Change | None:
    rods = rods_on_balls(mechanism) if _moves(mechanism) else []
    if not rods:
        return None
    return {"lock_spin": [*_listed(table, "lock_spin"), *rods]}, (
        "rods between ball joints can spin freely about their own lines: one ball joint of each becomes a universal joint"
        f" (mechanism.lock_spin: {', '.join(rods)})"
    )


def _filters_left_out(mechanism: Mechanism, table: Mapping[str, object]) -> Change | None:
    model = mechanism.model
    filtered = np.isin(model.actuator_dyntype, FILTERS) & (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    on_joints = {model.joint(int(model.actuator_trnid[a, 0])).name: label(model, int(a)) for a in np.flatnonzero(filtered)}
    named = {joint: actuator for joint, actuator in on_joints.items() if joint}
    if not named:
        return None
    return {"drive": [*_listed(table, "drive"), *named]}, (
        "filters of actuators are ignored, in simulation too, because plans do not model their states:"
        f" {', '.join(named.values())} (mechanism.drive: {', '.join(named)})"
    )


def _overlaps_excluded(mechanism: Mechanism, table: Mapping[str, object]) -> Change | None:
    pairs = not_on_ground(contact_pairs(mechanism, mechanism.home[None])) if mechanism.dof else []
    return (with_exclusions(table, pairs), overlap_sentence(pairs)) if pairs else None


def _friction_widened(mechanism: Mechanism, table: Mapping[str, object]) -> Change | None:
    rubs = max(mechanism.model.dof_frictionloss.max(initial=0.0), mechanism.model.tendon_frictionloss.max(initial=0.0)) > 0
    if not rubs or not is_large(mechanism) or "friction_transition_deg_s" in table:
        return None
    # With the default of 2 deg/s, xArm's first motion takes 16 s of processor time. With 10 it takes 2 s, and its tracking
    # error doubles.
    default, wide = float(np.degrees(mechanism.friction_transition)), 10.0
    return {"friction_transition_deg_s": wide}, (
        f"dry friction reaches its full value at about {wide:g} deg/s instead of {default:g}, to avoid fine meshes: plans"
        " have too little friction on slow joints (mechanism.friction_transition_deg_s)"
    )


def _locked(
    find: Callable[[Mechanism], dict[str, float]], why: str, mechanism: Mechanism, table: Mapping[str, object]
) -> Change | None:
    """Return the locks of joints [deg or m] that `find` adds to those of a table; None if it adds none.

    The joints coupled to them are locked, too, and also rest at home.
    """
    model, places = mechanism.model, find(mechanism) if _moves(mechanism) else {}
    couplings = np.flatnonzero((model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_obj2id >= 0) & model.eq_active0)
    tied = [{joint_label(model, int(j)) for j in (model.eq_obj1id[k], model.eq_obj2id[k])} for k in couplings]
    for _ in tied:
        names = set().union(*(pair for pair in tied if not pair.isdisjoint(places)))
        homes = zip(mechanism.joints, mechanism.home, strict=True)
        places = {joint.name: joint.shown(float(x)) for joint, x in homes if joint.name in names} | places
    locks = {name: round(place, 9) + 0.0 for name, place in places.items()}  # a home pose is assembled to 1e-15
    if not locks:
        return None
    given, text = table.get("lock"), ", ".join(f"{name} = {value:g}" for name, value in locks.items())
    whole = {**(given if isinstance(given, Mapping) else {}), **locks}
    return {"lock": whole}, why.replace("{locks}", f"mechanism.lock: {text}")


def _listed(table: Mapping[str, object], key: str) -> list:
    """Return the list that a [mechanism] table has at a key; empty without one."""
    value = table.get(key)
    return value if isinstance(value, list) else []


def _moves(mechanism: Mechanism) -> bool:
    return mechanism.dof > 0 and mechanism.n_u > 0


def with_exclusions(table: Mapping[str, object], pairs: Sequence[list[str]]) -> dict[str, object]:
    """Return a [mechanism] table that also excludes the contacts of pairs of bodies."""
    return {**table, "exclude_contacts": [*_listed(table, "exclude_contacts"), *pairs]}


def raised_limits(mechanism: Mechanism) -> dict[str, list[float]]:
    """Return raised effort limits [N.m or N] by actuator, for those that are too weak to hold the weight at home.

    Actuators with the same limits are probably the same motor, or have an exporter's default, so their limits are raised
    together.
    """
    still = np.zeros((1, mechanism.dof))
    (hold,), _ = needed_effort(mechanism, mechanism.home[None], still, still)
    low, high = mechanism.effort_limit.T
    if np.all((hold >= low) & (hold <= high)):
        return {}
    # The ends beyond zero alone are raised: a cable still pulls, and need not pull more.
    widened = np.stack([np.where(low < 0, -np.inf, low), np.where(high > 0, np.inf, high)], axis=1)
    (hold,), _ = needed_effort(mechanism, mechanism.home[None], still, still, limit=widened)
    limits = [tuple(float(x) for x in ends) for ends in mechanism.effort_limit]
    factors: dict[tuple[float, ...], float] = {}
    for effort, ends in zip(hold, limits, strict=True):
        end = ends[1] if effort > 0 else ends[0]
        if abs(effort) > abs(end) > 0:
            factors[ends] = max(factors.get(ends, 0.0), HOLD_MULTIPLE * abs(effort) / abs(end))
    return {
        actuator.name: [float(f"{x * factors[ends]:.3g}") for x in ends]
        for actuator, ends in zip(mechanism.actuators, limits, strict=True)
        if ends in factors
    }


def raised_notes(mechanism: Mechanism, tables: Mapping[str, Mapping]) -> list[str]:
    """Return a sentence on the effort limits of a problem's tables that are larger than the model's, if there are any."""
    limits = tables.get("limits", {}).get("effort", {})
    if not limits:
        return []
    raised = ", ".join(
        f"{actuator.name} {limits[actuator.name]} instead of {[float(f'{x:.4g}') for x in ends]} {actuator.unit}"
        for actuator, ends in zip(mechanism.actuators, mechanism.effort_limit, strict=True)
        if actuator.name in limits
    )
    return [
        f"actuators, or others with the same limits, are too weak to hold the weight at home: limits.effort takes {raised};"
        " replace them by your motors' limits"
    ]


@functools.lru_cache(maxsize=4)
def left_out(mechanism: Mechanism) -> tuple[str, ...]:
    """Return the forces of a model that plans neglect, each as a phrase."""
    return tuple(element.text for element in audit(mechanism.model) if element.falsifies)


def left_out_notes(mechanism: Mechanism) -> list[str]:
    """Return a sentence on the forces that a first motion neglects, if there are any."""
    forces = left_out(mechanism)
    count = f"{len(forces)} forces" if len(forces) > 1 else "forces"
    what = "; ".join(grouped(mechanism, forces)[:3])
    return [
        f"plans neglect {count} that act in the simulation: {what}"
        ' (limits.unhonoured = "note"; the default is to refuse such a problem)'
    ] * bool(forces)


def not_on_ground(contacts: Iterable[Contact | ContactPair]) -> list[list[str]]:
    """Return the pairs of bodies in contact, without pairs in contact with the ground."""
    pairs: dict[tuple[str, str], bool] = {}
    for contact in contacts:
        pairs[contact.bodies] = pairs.get(contact.bodies, False) or contact.on_ground
    return [list(pair) for pair, on_ground in pairs.items() if not on_ground]


def overlap_sentence(pairs: Sequence[Sequence[str]]) -> str:
    """Return the sentence on the contacts of overlapping links."""
    return (
        "links overlap at home, or on a pin that they share, and would push each other off in simulation: the contacts of"
        f" {', '.join(f'{first} and {second}' for first, second in pairs)} are excluded (mechanism.exclude_contacts)"
    )


def _assembled(table: Mapping[str, object], before: Mechanism | None = None) -> Mechanism:
    """Return a model's mechanism, assembled at the nearest closed pose if the model's pose is open.

    The search for that pose is skipped if `before`, the mechanism without the last change, was assembled there and the
    change does not concern its joints.
    """
    tables, homes, locked = {"mechanism": dict(table)}, {}, table.get("lock")
    for key in ("home_deg", "home_m"):  # before the change, without the joints that the table locks
        found = before.source.get(key) if before is not None and key not in table else None
        if isinstance(found, Mapping):
            homes[key] = {n: x for n, x in found.items() if not isinstance(locked, Mapping) or n not in locked}
    if home := {key: found for key, found in homes.items() if found}:
        try:
            return mechanism_from_tables({"mechanism": {**table, **home}})
        except LinkplanError:
            pass
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


# The order matters: fixed and locked parts determine which links overlap and the mechanism's size.
_CHANGES: tuple[Callable[[Mechanism, Mapping[str, object]], Change | None], ...] = (
    _filters_left_out,
    functools.partial(_locked, fixed_by_range, "joints with ranges of zero width are locked ({locks})"),
    functools.partial(
        _locked,
        pressed,
        "joints that weight and springs press onto their stops are locked there ({locks}); motions that leave the stops"
        " need another model",
    ),
    functools.partial(
        _locked,
        dropped,
        "undriven joints that would fall onto their stops or into a contact are locked at home ({locks}), because plans"
        " have no contact forces; motions in which they fall need another model",
    ),
    functools.partial(
        _locked,
        held_by_friction,
        "undriven joints that dry friction holds are locked in place ({locks}); motions that slide them need another model",
    ),
    _ball_rods_locked,
    functools.partial(
        _locked,
        spins,
        "rods or wheels can spin freely while everything else rests: one hinge of each is locked ({locks})",
    ),
    _overlaps_excluded,
    _friction_widened,
)
