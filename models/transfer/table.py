"""Transfer tables: a linkage over the range of its output joints, and the inverse map from motor positions.

The closed poses are on the branch of home.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from linkplan.models.errors import ModelError
from linkplan.models.poses.along import RANGE_ROUNDING
from linkplan.models.poses.assembly import advance_all, step_sizes, strides
from linkplan.models.poses.inverse_kinematics import ARRIVED_SHARE
from linkplan.models.poses.reach import Reach, reach, toggles
from linkplan.models.transfer.grid import Function, Grid, adaptive_grid, interpolated
from linkplan.models.transfer.output_map import OutputMap, motor_map, transmission

# Status of a point: on the map; the loops do not close there; next to a singular pose; or 100 plus the index of the joint
# that is beyond its range.
ON_MAP, OPEN_LOOPS, NEAR_SINGULAR, BEYOND_RANGE = 0, 1, 2, 100


class KnownPoses:
    """The closed poses found so far. A new pose is continued from the nearest one. Mutable: it grows."""

    def __init__(self, outputs: OutputMap) -> None:
        self.outputs = outputs
        self.poses, self.points = outputs.mechanism.home[None], outputs.home[None]
        self.unit = step_sizes(outputs.mechanism)[outputs.coordinates]
        self._tree = None  # of the points; made when it is first used

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the poses (n, n_q) at output positions (n, n_o), NaN where the loops open, and each point's status (n,)."""
        mechanism = self.outputs.mechanism
        found, tried = self.near(points), np.full(len(points), -1)
        self._keep(found)
        while True:  # start open points from their nearest known pose, until none has a nearer one
            left = np.flatnonzero(np.isnan(found[:, 0]))
            nearest = self._nearest(points[left])
            left, nearest = left[nearest != tried[left]], nearest[nearest != tried[left]]
            if len(left) == 0:
                return found, self._status(found)
            tried[left] = nearest
            found[left] = advance_all(mechanism, self.poses[nearest], self.outputs.independent(points[left]))
            self._keep(found[left])

    def near(self, points: np.ndarray) -> np.ndarray:
        """Return the poses (n, n_q) that are one stride from a known pose, NaN for others."""
        return strides(self.outputs.mechanism, self.poses[self._nearest(points)], self.outputs.independent(points))

    def _nearest(self, points: np.ndarray) -> np.ndarray:
        """Return the indices (n,) of the known poses that are nearest to output positions (n, n_o)."""
        import scipy.spatial

        if self._tree is None:
            self._tree = scipy.spatial.KDTree(self.points / self.unit, balanced_tree=False, compact_nodes=False)
        return np.asarray(self._tree.query(points / self.unit)[1])

    def _keep(self, found: np.ndarray) -> None:
        closed = found[np.isfinite(found[:, 0])]
        if len(closed):
            self.poses, self._tree = np.concatenate([self.poses, closed]), None
            self.points = self.poses[:, self.outputs.coordinates]

    def _status(self, found: np.ndarray) -> np.ndarray:
        mechanism = self.outputs.mechanism
        lower, upper = np.array([(joint.lower, joint.upper) for joint in mechanism.joints]).T
        beyond = np.maximum(found - upper, lower - found)
        beyond[:, mechanism.independent] = 0.0
        worst = np.argmax(np.nan_to_num(beyond), axis=1)
        status = np.where(np.nan_to_num(beyond).max(axis=1) > RANGE_ROUNDING, BEYOND_RANGE + worst, ON_MAP)
        return np.where(np.isnan(found[:, 0]), OPEN_LOOPS, status)


# The share of the reach that a table keeps from a singular pose, where G has no limit.
_SINGULAR_MARGIN_SHARE = 0.005
# Beyond this multiple of the median transmission along the reach a pose counts as singular: G grows without limit there.
_SINGULAR_RATIO_MULTIPLE = 10.0
# The quantities whose interpolation keeps the tolerance. Slopes are given, and their error is measured.
REFINED = ("motor_position", "ratio", "inertia", "gravity")
# The largest number of nodes of a table. A controller's table has hundreds; the largest one measures its remaining error.
MOST_NODES = 4000
MOST_JOINTS = 3
# Status of an unreachable node of the inverse map, without which the cells at the edge of the map would lack a corner.
BESIDE_MAP = 3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MapEnd:
    """An end of a table's axis [rad or m]: the reason for it, and the distance kept from a singular pose."""

    position: float
    reason: str
    margin: float = 0.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Inverse(Grid):
    """The output joints' positions over the motors' positions, with the `status` of each node.

    `answered` is the share of reachable positions, at random, that interpolation answers; `errors` are measured with them.
    """

    answered: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class TransferTable:
    """A linkage over the range of its output joints, with the fields of `Transmission`, `pose` (n_q,) and `status`.

    `ends` are those of each axis with the other outputs at home. `dead_centres` are pairs (motor, output position) at which
    a motor of a mechanism with one output reverses while the output moves on: it has no moment arm there. `inverse` is the
    output joints' position over the motors' positions, None where the motors do not determine it; `inverse_note` says why.
    """

    outputs: OutputMap
    tolerance: float
    grid: Grid
    ends: tuple[tuple[MapEnd, MapEnd], ...]
    dead_centres: tuple[tuple[int, float], ...]
    inverse: Inverse | None
    inverse_note: str

    @property
    def known(self) -> np.ndarray:
        """A mask (shape of the grid) of the nodes on the map."""
        return self.grid.values["status"] == ON_MAP


def transfer_table(
    outputs: OutputMap, tolerance: float, ends: Sequence[tuple[float, float] | None] = (), most_nodes: int = MOST_NODES
) -> TransferTable:
    """Return the transfer table of output joints.

    Args:
        outputs: the joints and the motors that move with them.
        tolerance: interpolation error allowed, as a share of each quantity's largest size.
        ends: of each output joint [rad or m], inside its reach; None for the whole reach.
        most_nodes: of the whole grid.

    Raises:
        ModelError: for more than three joints, or an end out of reach.
    """
    if len(outputs.columns) > MOST_JOINTS:
        raise ModelError(f"a table has at most {MOST_JOINTS} joints, got {len(outputs.columns)}; make one for each linkage")
    reaches = [reach(outputs.mechanism, column) for column in outputs.columns]
    limits = tuple(_ends(outputs, k, one, ends[k] if ends else None) for k, one in enumerate(reaches))
    poses = KnownPoses(outputs)

    along = np.concatenate([one.poses for one in reaches])
    most = _SINGULAR_RATIO_MULTIPLE * np.nanmedian(np.abs(transmission(outputs, along).ratio).max(axis=(1, 2)))

    def function(points: np.ndarray) -> dict[str, np.ndarray]:
        found, status = poses.at(points)
        quantities = asdict(transmission(outputs, found))
        steep = np.abs(quantities["ratio"]).max(axis=(1, 2)) > most
        status = np.where((status == ON_MAP) & steep, NEAR_SINGULAR, status)
        values = {"pose": found, "status": status.astype(float)} | quantities
        for name, value in values.items():
            if name != "status":
                value[status != ON_MAP] = np.nan
        return values

    spans = [(low.position, high.position) for low, high in limits]
    refined = REFINED if all(actuator.has_length for actuator in outputs.actuators) else REFINED[1:]
    grid = adaptive_grid(function, spans, tolerance, refined, most_nodes)
    if np.count_nonzero(grid.values["status"] == ON_MAP) < 2:
        names = ", ".join(joint.name for joint in outputs.joints)
        raise ModelError(
            f"the table of {names} has fewer than 2 nodes at regular closed poses; give it another range or home"
        )
    inverse, note = _inverse(outputs, function, grid, poses, tolerance, most_nodes)
    dead = _dead_centres(outputs, reaches[0], limits[0]) if len(reaches) == 1 else ()
    return TransferTable(
        outputs=outputs, tolerance=tolerance, grid=grid, ends=limits, dead_centres=dead, inverse=inverse, inverse_note=note
    )


def _ends(outputs: OutputMap, k: int, found: Reach, asked: tuple[float, float] | None) -> tuple[MapEnd, MapEnd]:
    """Return the ends of an axis: those asked for, or the reach less a margin to singular poses."""
    joint, home = outputs.joints[k], float(outputs.home[k])
    low, high = found.once
    if found.turns_fully and found.period is None:
        half = 0.5 * (high - low) / 2
        low, high = home - half, home + half
    width, ends = high - low, []
    if width <= 0:
        raise ModelError(f"joint {joint.name} cannot move from home: {found.lower.reason}; {found.upper.reason}")
    for end, sign, position in ((found.lower, 1, low), (found.upper, -1, high)):
        margin = _SINGULAR_MARGIN_SHARE * width if end.reason == "singular pose" else 0.0
        ends.append(MapEnd(position=position + sign * margin, reason=end.reason, margin=margin))
    if asked is None:
        return ends[0], ends[1]
    if not ends[0].position <= asked[0] < asked[1] <= ends[1].position:
        raise ModelError(
            f"the range of {joint.name} is inside {joint.text(ends[0].position, 6)} to {joint.text(ends[1].position, 6)}"
            f" {joint.unit} ({ends[0].reason}; {ends[1].reason}), got {joint.text(asked[0], 6)} to {joint.text(asked[1], 6)}"
        )
    share = 1e-6  # positions of motors at closer poses differ by rounding alone
    if asked[1] - asked[0] < share * width:
        raise ModelError(
            f"the range of {joint.name} is at least {share:g} of its reach of {joint.text(width, 6)}"
            f" {joint.unit} wide, got {joint.shown(asked[0]):g} to {joint.shown(asked[1]):g}"
        )
    return MapEnd(position=asked[0], reason="asked for"), MapEnd(position=asked[1], reason="asked for")


def _dead_centres(outputs: OutputMap, found: Reach, ends: tuple[MapEnd, MapEnd]) -> tuple[tuple[int, float], ...]:
    """Return the pairs (place among the motors, output position) at which a motor on a joint reverses."""
    motors = {actuator.joint: place for place, actuator in enumerate(outputs.actuators)}
    return tuple(
        (motors[joint], position)
        for joint, position in toggles(outputs.mechanism, found.coordinate)
        if joint in motors and ends[0].position < position < ends[1].position
    )


def _inverse(
    outputs: OutputMap, forth: Function, grid: Grid, poses: KnownPoses, tolerance: float, most_nodes: int
) -> tuple[Inverse | None, str]:
    """Return the table of output positions over motor positions, and the reason why there is none."""
    motor = grid.values["motor_position"].reshape(-1, len(outputs.motors))
    if len(outputs.motors) != len(outputs.columns):
        return None, f"{len(outputs.motors)} motors do not determine {len(outputs.columns)} joints one by one"
    if not all(actuator.has_length for actuator in outputs.actuators):
        return None, "a motor on a site or slider-crank has no position"
    known = np.isfinite(motor).all(axis=1)
    if np.ptp(motor[known], axis=0).min() == 0:
        return None, "a motor stands still over the whole range"
    ratio = grid.values["ratio"].reshape(-1, len(outputs.motors), len(outputs.columns))
    turn = np.linalg.det(ratio[known])
    if turn.min() <= 0 <= turn.max():
        return None, "a motor passes a dead centre on the way: one motor position has two joint positions"
    slope = grid.values["ratio_slope"].reshape(*ratio.shape, -1)[known]
    pairs = _Pairs(joint=grid.points[known], motor=motor[known], ratio=ratio[known], slope=slope)
    low, high = (np.array([axis[end] for axis in grid.axes]) for end in (0, -1))
    beyond = 0.125 * (high - low)  # cells at the edge of the map have nodes there

    def back(points: np.ndarray) -> dict[str, np.ndarray]:
        return {"joint_position": _joint_positions(outputs, poses, pairs, points, (low - beyond, high + beyond))}

    spans = list(zip(pairs.motor.min(axis=0).tolist(), pairs.motor.max(axis=0).tolist(), strict=True))
    found = adaptive_grid(back, spans, tolerance, ["joint_position"], most_nodes)
    s = low + np.random.default_rng(1).random((MOST_NODES // 2, len(low))) * (high - low)
    values = forth(s)
    on_map = values["status"] == ON_MAP
    return _completed(found, pairs, s[on_map], values["motor_position"][on_map], (low, high)), ""


def _completed(grid: Grid, pairs: _Pairs, joint: np.ndarray, motor: np.ndarray, box: tuple[np.ndarray, ...]) -> Inverse:
    """Return a table with its missing nodes filled in every cell that has reachable positions, and in the cells next to it.

    A cell at the edge of the map has nodes off it: there the position is extrapolated from the nearest known pair.

    Args:
        grid: with NaN off the map.
        pairs: known positions of joints and motors.
        joint: reachable positions (n, n_o), with which the error is measured.
        motor: the motors' positions (n, n_m) there.
        box: the ends of the output joints' ranges.
    """
    position, shape = np.array(grid.values["joint_position"]), tuple(len(axis) for axis in grid.axes)
    near = np.zeros(shape, dtype=bool)
    for places in (pairs.motor, motor):
        cell = [
            np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
            for axis, x in zip(grid.axes, places.T, strict=True)
        ]
        for corner in itertools.product((-1, 0, 1, 2), repeat=len(shape)):
            near[tuple(np.clip(k + up, 0, n - 1) for k, up, n in zip(cell, corner, shape, strict=True))] = True
    flat, points = position.reshape(-1, len(shape)), grid.points
    low, high = (end + sign * 1e-9 * (box[1] - box[0]) for end, sign in zip(box, (-1, 1), strict=True))
    inside = np.all((flat >= low) & (flat <= high), axis=1)
    missing = np.flatnonzero(near.ravel() & np.isnan(flat).any(axis=1))
    flat[missing] = pairs.extrapolated(points[missing])
    status = np.where(inside, ON_MAP, np.where(np.isnan(flat).any(axis=1), OPEN_LOOPS, BESIDE_MAP))
    values = {"joint_position": position, "status": status.reshape(shape).astype(float)}
    off = np.abs(interpolated(grid.axes, position, motor) - joint) / grid.scale["joint_position"]
    answered = np.isfinite(off).all(axis=1)
    errors = {"joint_position": float(off[answered].max(initial=0.0))}
    return Inverse(
        axes=grid.axes,
        values=values,
        scale=grid.scale,
        errors=errors,
        checked=len(joint),
        answered=float(answered.mean()) if len(joint) else 0.0,
    )


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Pairs:
    """Positions of joints (n, n_o) and motors (n, n_m) at the same poses, G (n, n_m, n_o) and dG/ds (n, n_m, n_o, n_o)."""

    joint: np.ndarray
    motor: np.ndarray
    ratio: np.ndarray
    slope: np.ndarray

    @property
    def unit(self) -> np.ndarray:
        return np.ptp(self.motor, axis=0)

    def nearest(self, wanted: np.ndarray) -> np.ndarray:
        """Return the indices (m,) of the pairs that are nearest to motor positions (m, n_m)."""
        import scipy.spatial

        return np.asarray(scipy.spatial.KDTree(self.motor / self.unit).query(wanted / self.unit)[1])

    def extrapolated(self, wanted: np.ndarray) -> np.ndarray:
        """Return joint positions (m, n_o) at motor positions (m, n_m), to the second order about the nearest pair."""
        at = self.nearest(wanted)
        off, back = wanted - self.motor[at], np.linalg.inv(self.ratio[at])
        first = np.einsum("kom,km->ko", back, off)
        bent = 0.5 * np.einsum("kmop,ko,kp->km", self.slope[at], first, first)
        return self.joint[at] + np.einsum("kom,km->ko", back, off - bent)


def _joint_positions(
    outputs: OutputMap, poses: KnownPoses, pairs: _Pairs, wanted: np.ndarray, box: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the output positions (n, n_o) at which the motors are at `wanted` (n, n_m), NaN outside a box or off the map.

    Newton with the exact map, s <- s + G^-1 (l - l(s)), from the nearest of the known pairs of output and motor positions.
    A position on the other side of a dead centre is off the map.
    """
    unit, s = pairs.unit, pairs.joint[pairs.nearest(wanted)]
    (low, high), side = box, np.sign(np.linalg.det(pairs.ratio[0]))
    done, lost = np.zeros(len(s), dtype=bool), np.zeros(len(s), dtype=bool)
    for _ in range(20):
        active = np.flatnonzero(~done & ~lost)
        if len(active) == 0:
            break
        q = poses.near(s[active])
        far = np.isnan(q[:, 0])
        q[far] = poses.at(s[active][far])[0]
        motor, ratio = motor_map(outputs, q)
        off = wanted[active] - motor
        lost[active] = ~np.isfinite(off).all(axis=1)
        ratio[lost[active]] = 0.0
        lost[active] |= ~(side * np.linalg.det(ratio) > 0)
        done[active] = ~lost[active] & (np.abs(off / unit).max(axis=1) < ARRIVED_SHARE)
        there = ~lost[active]
        step = np.linalg.solve(ratio[there], off[there][:, :, None])[:, :, 0]
        s[active[there]] = np.clip(s[active[there]] + step, low, high)
    s[~done] = np.nan
    return s
