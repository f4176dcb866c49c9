"""Contacts between geoms along poses. The reduced dynamics contain no contact forces.

Contacts come from MuJoCo's own collision detection with the model's filters, pairs, margins and exclusions. A contact acts
if the distance of two surfaces is below the margin, and its depth is the difference.
"""

import copy
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise

import mujoco
import numpy as np
from msgspec import Struct

from linkplan.models.closure.rank import FILE_ROUNDING_SHARE
from linkplan.models.deadline import NO_DEADLINE, Deadline, one_thread_at_a_time
from linkplan.models.kinematics import BALL, HINGE, data_at, in_body, in_world, may_collide, tied_points
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at

# An overlap at most this share deeper than at home counts as part of the design: that of two links on a pin varies with the
# pose.
_EXTRA_DEPTH_SHARE = 0.1

# No contact is searched for between two instants if the geoms travel less than this share of the extent (30 um on a leg).
_LEAST_TRAVEL_SHARE = 1e-4
# Accuracy of the instant at which geoms meet, as a share of the motion.
_INSTANT_SHARE = 1e-10

Pair = tuple[int, int]
Point = tuple[int, np.ndarray]  # a body and a position (3,) [m] in its frame


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ContactPair:
    """Two geoms in contact at some of the checked poses: the indices of these poses and the largest depth [m].

    One of them is the ground if it is a plane, or a part of the world larger than the mechanism; smaller parts of the world
    are the machine's base.
    """

    geoms: tuple[str, str]
    bodies: tuple[str, str]
    poses: tuple[int, ...]
    depth_m: float
    on_ground: bool


class Contact(Struct, frozen=True, eq=False, kw_only=True):
    """Two geoms in contact along a motion.

    `since_s` is the first instant of a contact that is not part of the design. It is None for an overlap that is as deep at
    home, or that is at a pin which the two bodies share.
    """

    geoms: tuple[str, str]
    bodies: tuple[str, str]
    since_s: float | None
    depth_m: float
    deepest_at_s: float
    home_depth_m: float
    on_ground: bool = False


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _PoseSample:
    """The geoms at one pose: the clearances [m] of near pairs, overall and away from shared pins, and the geoms' frames."""

    clearance: dict[Pair, tuple[float, float]]
    centres: np.ndarray  # (n_geoms, 3)
    frames: np.ndarray  # (n_geoms, 3, 3)

    def away(self, pair: Pair) -> float:
        """Return the clearance of a pair away from the pins that its bodies share."""
        return self.clearance.get(pair, (np.inf, np.inf))[1]


def contact_pairs(mechanism: Mechanism, poses: np.ndarray) -> tuple[ContactPair, ...]:
    """Return the pairs of geoms in contact at poses (n, n_q); surfaces that touch by rounding are not in contact."""
    model, rounding = mechanism.model, FILE_ROUNDING_SHARE * mechanism.extent_m
    if not may_collide(model):
        return ()
    data, points = mujoco.MjData(model), [np.empty((0, 4))]  # rows: a pose's number, the two geoms, their depth
    for k, qpos in enumerate(mechanism.qpos_of(poses)):
        pairs, distance, _ = _detected(model, data, qpos)
        points.append(np.column_stack([np.full(len(pairs), k), pairs, -distance])[-distance > rounding])
    number, *geoms, depth = np.vstack(points).T
    pairs, of = np.unique(np.ravel_multi_index(np.array(geoms, dtype=int), 2 * (model.ngeom,)), return_inverse=True)
    return tuple(
        ContactPair(
            geoms=(geom_name(model, first), geom_name(model, second)),
            bodies=_bodies(model, (first, second)),
            poses=tuple(np.unique(number[of == i].astype(int)).tolist()),
            depth_m=float(depth[of == i].max()),
            on_ground=_on_ground(mechanism, (first, second)),
        )
        for i, (first, second) in enumerate(np.transpose(np.unravel_index(pairs, 2 * (model.ngeom,))).tolist())
    )


@one_thread_at_a_time
def meetings(
    mechanism: Mechanism,
    time: np.ndarray,
    poses: np.ndarray,
    position_at: Callable[[np.ndarray], np.ndarray],
    deadline: Deadline = NO_DEADLINE,
) -> tuple[Contact, ...]:
    """Return the contacts along a motion in the order of their instants, followed by overlaps by construction.

    More instants are checked between two where the geoms' distances and travel allow a contact.

    Args:
        mechanism: the assembled mechanism.
        time: increasing instants (n,), or another path parameter.
        poses: closed poses (n, n_q) at these instants.
        position_at: independent positions (m, n_s) at instants (m,), for poses between.
        deadline: of the computation.

    Raises:
        OutOfTimeError: if the deadline passes before the motion's end.
    """
    model = mechanism.model
    if not may_collide(model):
        return ()
    size, sample = _bounding_radii(mechanism), _pose_sampler(mechanism, model, deadline)
    first = list(sample(poses))
    span = max((_travel(a, b, size).max() for a, b in pairwise(first)), default=0.0)
    sample = _pose_sampler(mechanism, _with_wider_gaps(mechanism, 2 * float(span)), deadline)
    (at_home,) = sample(mechanism.home[None])
    seen = [(float(t), pose, one) for t, pose, one in zip(time, poses, sample(poses), strict=True)]
    seen = _sampled_between(mechanism, seen, sample, position_at, size)
    pairs = sorted({pair for _, _, one in seen for pair, (clearance, _) in one.clearance.items() if clearance <= 0})
    found = [_meeting(mechanism, pair, at_home, seen, sample, position_at) for pair in pairs]
    return tuple(sorted(found, key=lambda meeting: np.inf if meeting.since_s is None else meeting.since_s))


def _meeting(mechanism: Mechanism, pair: Pair, at_home: _PoseSample, seen, sample, position_at) -> Contact:
    """Return a pair's contact along the samples `seen` of a motion."""
    model, extent = mechanism.model, mechanism.extent_m
    depth = np.array([-one.clearance.get(pair, (np.inf, np.inf))[0] for _, _, one in seen])
    away = np.array([-one.away(pair) for _, _, one in seen])
    allowed = (1 + _EXTRA_DEPTH_SHARE) * max(0.0, -at_home.away(pair)) + FILE_ROUNDING_SHARE * extent
    deeper = np.flatnonzero(away > allowed)
    since, deepest = None, int(np.argmax(depth))
    if len(deeper):
        since, deepest = _onset(mechanism, pair, allowed, int(deeper[0]), seen, sample, position_at), int(np.argmax(away))
    return Contact(
        geoms=(geom_name(model, pair[0]), geom_name(model, pair[1])),
        bodies=_bodies(model, pair),
        since_s=since,
        depth_m=float(depth[deepest]),
        deepest_at_s=seen[deepest][0],
        home_depth_m=max(0.0, -at_home.clearance.get(pair, (np.inf, np.inf))[0]),
        on_ground=_on_ground(mechanism, pair),
    )


def _onset(mechanism: Mechanism, pair: Pair, allowed: float, k: int, seen, sample, position_at) -> float:
    """Return the instant between samples k - 1 and k at which a pair's depth exceeds `allowed`."""
    if k == 0:
        return seen[0][0]
    (before, pose, _), after = seen[k - 1], seen[k][0]
    least = _INSTANT_SHARE * (seen[-1][0] - seen[0][0])
    while after - before > least:
        middle = (before + after) / 2
        there = close_at(mechanism, position_at(np.array([middle]))[0], pose)
        (one,) = sample(there[None])
        if -one.away(pair) > allowed:
            after = middle
        else:
            before, pose = middle, there
    return after


def _sampled_between(mechanism: Mechanism, seen, sample, position_at, size: np.ndarray) -> list:
    """Return the samples of a motion, refined where a contact could occur between two samples."""
    least = _LEAST_TRAVEL_SHARE * mechanism.extent_m
    result, ahead = [seen[0]], list(reversed(seen[1:]))
    while ahead:
        (begin, pose, one), (end, _, other) = result[-1], ahead[-1]
        travel = _travel(one, other, size)
        near = [
            pair
            for pair in one.clearance.keys() & other.clearance.keys()
            if min(one.away(pair), other.away(pair)) > 0
            and one.away(pair) + other.away(pair) <= travel[pair[0]] + travel[pair[1]]
            and travel[pair[0]] + travel[pair[1]] > least
        ]
        if near and end - begin > _INSTANT_SHARE * (seen[-1][0] - seen[0][0]):
            middle = (begin + end) / 2
            there = close_at(mechanism, position_at(np.array([middle]))[0], pose)
            ahead.extend((middle, there, one) for one in sample(there[None]))
        else:
            result.append(ahead.pop())
    return result


def _pose_sampler(
    mechanism: Mechanism, model: mujoco.MjModel, deadline: Deadline = NO_DEADLINE
) -> Callable[[np.ndarray], Iterator[_PoseSample]]:
    """Return a function that yields the collision sample of each pose (n, n_q)."""
    pins = _shared_pins(mechanism)
    data = mujoco.MjData(model)
    weld, body, radius = model.body_weldid, model.geom_bodyid, _bounding_radii(mechanism)

    def on_a_pin(pair: Pair, place: np.ndarray) -> bool:
        first, second = sorted(int(weld[body[geom]]) for geom in pair)
        shared = pins.get((first, second), ())
        places = (data.xpos[of] + data.xmat[of].reshape(3, 3) @ local for of, local in shared)
        return any(np.linalg.norm(place - pin) <= min(radius[list(pair)]) for pin in places)

    def look(qpos: np.ndarray) -> _PoseSample:
        deadline.require_time()
        clearance: dict[Pair, tuple[float, float]] = {}
        pairs, distances, places = _detected(model, data, qpos)
        for pair, distance, place in zip(map(tuple, pairs.tolist()), distances.tolist(), places, strict=True):
            anywhere, away = clearance.get(pair, (np.inf, np.inf))
            away = away if on_a_pin(pair, place) else min(away, distance)
            clearance[pair] = (min(anywhere, distance), away)
        return _PoseSample(
            clearance=clearance, centres=data.geom_xpos.copy(), frames=data.geom_xmat.reshape(-1, 3, 3).copy()
        )

    def sample(poses: np.ndarray) -> Iterator[_PoseSample]:
        return map(look, mechanism.qpos_of(poses))  # one call for all poses: it takes longer than the collisions

    return sample


def _detected(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the m points of contact at a pose: pairs of geoms (m, 2), their distances (m,) [m], the places (m, 3)."""
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    contact, pairs = data.contact, np.sort(data.contact.geom, axis=1)
    of_geoms = pairs[:, 0] >= 0  # not of a flex, which `audit` reports
    return pairs[of_geoms], (contact.dist - contact.includemargin)[of_geoms], contact.pos[of_geoms]


@functools.lru_cache(maxsize=16)
def _shared_pins(mechanism: Mechanism) -> Mapping[tuple[int, int], tuple[Point, ...]]:
    """Return the pins that pairs of bodies share. Keys are pairs of `body_weldid`, the smaller first.

    Geoms overlap at a shared pin by construction, which is no collision. The anchor of a joint lies on its body and on the
    parent. The point of a connect or weld lies on both bodies that it ties. Two bodies share a pin if two of their points
    coincide at home, which includes siblings on a pivot and three links on a bolt. Bodies without a joint between them count
    as one body, as in MuJoCo's own collision filter.
    """
    model, extent = mechanism.model, mechanism.extent_m
    data = data_at(model, mechanism.qpos_of(mechanism.home))
    found: list[tuple[int, np.ndarray]] = []
    for joint in range(model.njnt):
        if int(model.jnt_type[joint]) in (HINGE, BALL):
            body = int(model.jnt_bodyid[joint])
            found += [(end, data.xanchor[joint].copy()) for end in (body, int(model.body_parentid[body]))]
    for index in np.flatnonzero(model.eq_active0):
        for body, place in tied_points(model, int(index)):
            found.append((body, in_world(data, body, place)))
    shared: dict[tuple[int, int], list[Point]] = {}
    for (one, here), (other, there) in combinations(found, 2):
        a, b = sorted((int(model.body_weldid[one]), int(model.body_weldid[other])))
        if a != b and np.linalg.norm(here - there) <= FILE_ROUNDING_SHARE * extent:
            shared.setdefault((a, b), []).append((one, in_body(data, one, here)))
    return {pair: tuple(points) for pair, points in shared.items()}


def _bounding_radii(mechanism: Mechanism) -> np.ndarray:
    """Return the bounding radius (n_geoms,) [m] of each geom; the model's extent for an infinite plane."""
    radius = mechanism.model.geom_rbound
    return np.where(radius > 0, radius, mechanism.extent_m)


def _travel(one: _PoseSample, other: _PoseSample, size: np.ndarray) -> np.ndarray:
    """Return an estimate (n_geoms,) [m] of the largest travel of any point of each geom between two samples."""
    turned = np.einsum("gij,gij->g", one.frames, other.frames)
    angle = np.arccos(np.clip((turned - 1) / 2, -1.0, 1.0))
    return np.linalg.norm(other.centres - one.centres, axis=1) + size * angle


def _with_wider_gaps(mechanism: Mechanism, width: float) -> mujoco.MjModel:
    """Return the second model, set to report distances up to `width` [m] beyond those that the mechanism's own reports."""
    model, wider = mechanism.model, _second_model(mechanism)
    wider.geom_gap[:] = model.geom_gap + width / 2
    wider.pair_gap[:] = model.pair_gap + width
    wider.body_margin[:] = model.body_margin + width
    return wider


@functools.lru_cache(maxsize=1)
def _second_model(mechanism: Mechanism) -> mujoco.MjModel:
    """Return a copy of a mechanism's model, which is kept: to copy meshes takes longer than to find a motion's contacts."""
    return copy.copy(mechanism.model)


def geom_name(model: mujoco.MjModel, index: int) -> str:
    """Return a geom's name, or a name made from its index and body."""
    return model.geom(index).name or f"geom {index} of {model.body(int(model.geom_bodyid[index])).name}"


def _bodies(model: mujoco.MjModel, pair: Pair) -> tuple[str, str]:
    first, second = (model.body(int(model.geom_bodyid[geom])).name for geom in pair)
    return first, second


def _on_ground(mechanism: Mechanism, pair: Pair) -> bool:
    """Tell if a geom of a pair is a plane, or a part of the world larger than the mechanism."""
    model, geoms = mechanism.model, list(pair)
    radius = model.geom_rbound[geoms]
    return bool(np.any((model.geom_bodyid[geoms] == 0) & ((radius == 0) | (radius > mechanism.extent_m))))


def exclusion(bodies: tuple[str, str]) -> str:
    """Return the MJCF element for <contact> that excludes contacts between two bodies."""
    from xml.sax.saxutils import quoteattr  # a slow import: it loads Python's HTTP client

    one, other = (quoteattr(body) for body in bodies)
    return f"<exclude body1={one} body2={other}/>"


def new_meetings(found: Iterable[Contact]) -> tuple[Contact, ...]:
    """Return the contacts that are not there by construction."""
    return tuple(meeting for meeting in found if meeting.since_s is not None)
