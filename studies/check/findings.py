"""The findings of `linkplan check` on contacts, pins and tendons: what invalidates a plan is a problem, all else a note."""

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np

from linkplan.models.kinematics import tied_points
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.contacts import ContactPair, exclusion, meetings
from linkplan.models.poses.reach import Reach
from linkplan.models.tree.joints import where
from linkplan.models.tree.tendons import SITE, is_fixed, lacks_length, path_of, tendon_label
from linkplan.planner.certificate.further_checks import contact_notes, geom_names
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath

# A pin farther than this share of the mechanism's extent from a body's shapes is off the body: shapes are simplified.
_OFF_SHARE = 0.02
# The fields of MuJoCo's model that make a tendon exert a force.
_PULLS = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss", "limited")


def reach_sentence(pair: ContactPair, n_poses: int) -> str:
    """Return the sentence on geoms that collide somewhere within reach."""
    return (
        f"geoms {' and '.join(pair.geoms)} collide in {len(pair.poses)} of {n_poses} poses within reach, up to"
        f" {1e3 * pair.depth_m:.2g} mm deep"
    )


def contact_findings(
    mechanism: Mechanism,
    pairs: tuple[ContactPair, ...],
    sweeps: Sequence[int],
    path: KinematicLoopPath | None,
    treatment: str,
) -> tuple[list[str], list[str]]:
    """Return the problems and notes on contacts, each a sentence.

    Args:
        mechanism: with the geoms.
        pairs: geoms that collide at some of the poses within reach.
        sweeps: the number of checked poses within the reach of each coordinate.
        path: a problem's motion; if None, the mechanism alone is checked and every contact is a problem.
        treatment: the problem's `contacts`, "refuse" or "note".
    """
    n_poses = sum(sweeps)
    if path is None:
        pads = [pair for pair in pairs if _meet_at_an_end(pair, sweeps)]
        return [
            f"{reach_sentence(pair, n_poses)}: contact forces are not planned for; {exclusion(pair.bodies)} in the model's"
            " <contact> lets links pass side by side"
            for pair in pairs
            if pair not in pads
        ], [
            f"geoms {' and '.join(pair.geoms)} touch near an end of the reach, like a gripper's pads or a stop, up to"
            f" {1e3 * pair.depth_m:.2g} mm deep: keep motions away from this end"
            for pair in pads
        ]
    way = np.arange(float(len(path.poses)))

    def position_at(at: np.ndarray) -> np.ndarray:
        return np.array([np.interp(at, way, column) for column in path.positions.T]).T

    problems, notes, named = [], [], set()
    found = meetings(mechanism, way, path.poses, position_at)
    notes.extend(contact_notes(tuple(meeting for meeting in found if meeting.since_s is None)))
    for meeting in found:
        named.add(meeting.geoms)
        if meeting.since_s is None:
            continue
        at = where(mechanism.independent_joints, position_at(np.array([meeting.since_s]))[0], 5)
        said = f"{geom_names(meeting)} collide at {at} on {path.title}, up to {1e3 * meeting.depth_m:.2g} mm deep"
        if treatment == "note":
            notes.append(f"{said}: plans have no contact forces")
        else:
            problems.append(f'{said}: a plan through it is refused unless limits.contacts = "note"')
    for pair in pairs:
        if pair.geoms not in named:
            notes.append(f"{reach_sentence(pair, n_poses)}, but not along {path.title}")
    return problems, notes


def _meet_at_an_end(pair: ContactPair, sweeps: Sequence[int]) -> bool:
    """Tell if two links touch only near one end of reaches."""
    meets = np.zeros(sum(sweeps), dtype=bool)
    meets[list(pair.poses)] = True
    for of_one in np.split(meets, np.cumsum(sweeps)[:-1]):
        changes = np.count_nonzero(np.diff(of_one.astype(int)))
        if of_one.any() and changes != 1:
            return False
    return not pair.on_ground


def stray_pins(mechanism: Mechanism) -> list[str]:
    """Return the notes on connects given by an anchor that is off both bodies: an anchor closes its loop wherever it is."""
    model, found = mechanism.model, []
    for closure in mechanism.closures:
        if closure.kind != "point" or int(model.eq_objtype[closure.index]) != int(mujoco.mjtObj.mjOBJ_BODY):
            continue
        off = [_distance_from_shapes(model, body, point) for body, point in tied_points(model, closure.index)]
        if min(off) > _OFF_SHARE * mechanism.extent_m:
            names = " and ".join(model.body(body).name for body, _ in tied_points(model, closure.index))
            found.append(
                f"pin {closure.name} lies {1e3 * min(off):.3g} mm off the shapes of both its bodies, {names}: check its"
                " anchor, or give a site on each body (site1, site2), so that a wrong length opens the loop"
            )
    return found


def _distance_from_shapes(model: mujoco.MjModel, body: int, point: np.ndarray) -> float:
    """Return the distance [m] of a point (3,) in a body's frame from the boxes around its geoms; 0 without any."""
    off = []
    for geom in range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        inside = turn.reshape(3, 3).T @ (point - model.geom_pos[geom]) - model.geom_aabb[geom, :3]
        off.append(float(np.linalg.norm(np.maximum(np.abs(inside) - model.geom_aabb[geom, 3:], 0.0))))
    return min(off, default=0.0)


def tendon_findings(mechanism: Mechanism, reaches: Sequence[Reach]) -> tuple[list[str], list[str]]:
    """Return the sentences on tendons outside their ranges at home, and on positions in the reach at which a range ends.

    Args:
        mechanism: with its tendons' limits.
        reaches: of its independent joints.
    """
    at_home = np.array(mechanism.dynamics.tendon_length(mechanism.home)).ravel()
    problems, notes = [], []
    for item, (tendon, here) in enumerate(zip(mechanism.tendons, at_home, strict=True)):
        said = f"[{tendon.low:g}, {tendon.high:g}] {tendon.unit}".rstrip()
        if not tendon.low <= here <= tendon.high:
            problems.append(
                f"tendon {tendon.name} has the length {here:.4g} at home, outside its range {said}: set another pose by"
                " mechanism.home_deg, or let linkplan.new find one"
            )
            continue
        for can in reaches:
            index = int(mechanism.independent[can.coordinate])
            joint, lengths = mechanism.joints[index], sampled(mechanism.dynamics.tendon_length, can.poses)[:, item, 0]
            x, stops = can.poses[:, index], []
            for over in (lengths - tendon.low, lengths - tendon.high):  # its zeros, by linear interpolation
                crossed = np.flatnonzero(over[:-1] * over[1:] < 0)
                stops += [x[k] - over[k] * (x[k + 1] - x[k]) / (over[k + 1] - over[k]) for k in crossed]
            if stops:
                at = ", ".join(joint.text(stop, 4) for stop in sorted(stops))
                notes.append(f"tendon {tendon.name} is at the end of its range {said} at {joint.name} = {at} {joint.unit}")
    return problems, notes


def coincident_sites(mechanism: Mechanism) -> list[str]:
    """Return a sentence on each tendon with a force between two sites that coincide at home, to 1e-10 of the extent."""
    model, said = mechanism.model, []
    places = np.array(mechanism.dynamics.site_places(mechanism.home))
    for tendon in filter(lambda tendon: _pulls(model, tendon), range(model.ntendon)):
        path = [int(model.wrap_objid[k]) if int(model.wrap_type[k]) == SITE else None for k in path_of(model, tendon)]
        for one, other in pairwise(path):
            if one is None or other is None or model.site_bodyid[one] == model.site_bodyid[other]:
                continue
            if np.linalg.norm(places[:, one] - places[:, other]) <= 1e-10 * mechanism.extent_m:
                names = " and ".join(model.site(site).name or f"site {site}" for site in (one, other))
                said.append(
                    f"tendon {tendon_label(model, tendon)} has no length between {names}, which coincide at home: its force"
                    " has no direction there (plans assume no force, the simulator the world's x axis); choose another home"
                    " pose, or move one of the sites"
                )
    return said


def _pulls(model: mujoco.MjModel, tendon: int) -> bool:
    """Tell if a tendon through sites exerts a force."""
    kinds, on = model.actuator_trntype, model.actuator_trnid[:, 0]
    driven = np.any((kinds == int(mujoco.mjtTrn.mjTRN_TENDON)) & (on == tendon))
    pulls = driven or any(np.any(getattr(model, f"tendon_{field}")[tendon]) for field in _PULLS)
    return bool(pulls) and not is_fixed(model, tendon) and not lacks_length(model, tendon)
