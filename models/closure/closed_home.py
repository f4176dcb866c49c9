"""The closed home pose of a mechanism: anchors moved where no joint closes a gap, the assembly, and the freedoms there."""

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import mujoco
import numpy as np

from linkplan.models.closure.equations import Closure, read_closures
from linkplan.models.closure.initial_assembly import (
    SHIFT_SHARE,
    Shift,
    apply_shifts,
    assemble,
    home_positions,
    locked_or_singular,
    nearby_poses,
    refuse_large_gaps,
    refuse_singular_assembly,
    removable_gaps,
    shifts,
    with_closed_pose,
)
from linkplan.models.closure.mobility import Mobility, closure_tolerance, judge_mobility, refuse_locked
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.errors import LockedError, UnassembledError
from linkplan.models.selection import home_qpos
from linkplan.models.tree.dynamics import Tree
from linkplan.models.tree.joints import Joint, unit_steps


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ClosedHome:
    """A closed pose (n_q,) near the model's reference pose (n_q,), and the mobility with the tolerances that hold there.

    `held` are the positions [rad or m] asked for, by the joints' indices. `moved` are the anchors that were moved. `about`
    are closed poses near home. A gap below `tolerance_m` is a rounding of the file. `extent_m` is the size of the bodies.
    """

    mobility: Mobility
    pose: np.ndarray
    about: list[np.ndarray]
    reference: np.ndarray
    held: dict[int, float]
    moved: list[Shift]
    tolerance_m: float
    extent_m: float

    def refuse_singular(self, free: np.ndarray) -> None:
        """Refuse a home that is singular, or an end of reach, for independent coordinates `free`.

        Raises:
            AssemblyError: for such a home. The message says how to choose another one, where there is one.
        """
        try:
            refuse_singular_assembly(self.mobility.loop, self.pose, free, self.about)
        except LockedError as error:
            raise locked_or_singular(error, self.mobility.loop, self.pose) from None
        except UnassembledError as error:
            raise with_closed_pose(error, self.mobility.loop, self.pose, self.extent_m) from None

    def reference_notes(self, rank: int) -> list[str]:
        """Return a note if the reference pose is closed and singular; `rank` is the closure's at home."""
        loop = self.mobility.loop
        there = loop.rank(self.reference)
        # [m]: the rank is meaningful only at a closed pose
        if loop.gap(loop.residual(self.reference)[0]) > 1e-6 or there == rank:
            return []
        return [f"the model's reference pose is singular: the closure has rank {there} there and {rank} at home"]


def close_home(
    name: str,
    model: mujoco.MjModel,
    tree: Tree,
    joints: tuple[Joint, ...],
    extent_m: float,
    *,
    home: Mapping[str, float] | None,
    tolerance_m: float | None,
) -> ClosedHome:
    """Return the closed home of a model; anchors are moved along their hinges' axes if only such a move closes a gap.

    Args:
        name: of the mechanism.
        model: compiled; moved anchors are written into it.
        tree: of the model.
        joints: its coordinates.
        extent_m: the size of the moving bodies.
        home: joint positions by name [rad or m] that are kept, as far as they are independent.
        tolerance_m: as `closure_tolerance_m` of `load_mechanism`.

    Raises:
        AssemblyError: if the loops do not close at, or near, the asked pose.
    """
    reference_qpos = home_qpos(model)
    closures, reference = read_closures(model, tree), tree.coordinates.q_of(reference_qpos)
    loop = _loop(name, joints, tree, closures, extent_m)
    tolerance = closure_tolerance(tolerance_m, extent_m)
    still, along_axes = removable_gaps(loop, reference), max(tolerance, SHIFT_SHARE * extent_m)
    refuse_large_gaps(loop, still, along_axes)
    moved = shifts(model, closures, still, reference_qpos, along_axes)
    if moved:
        apply_shifts(model, moved)
        loop = _loop(name, joints, tree, read_closures(model, tree), extent_m)
    held = home_positions(loop, home)
    try:
        pose = assemble(loop, reference, held, tolerance)
    except UnassembledError as error:
        raise with_closed_pose(error, loop, reference, extent_m) from None
    mobility = judge_mobility(loop, pose, tolerance)
    refuse_locked(mobility, pose, tolerance)
    return ClosedHome(
        mobility=mobility,
        pose=pose,
        about=nearby_poses(mobility.loop, pose),
        reference=reference,
        held=held,
        moved=moved,
        tolerance_m=tolerance,
        extent_m=extent_m,
    )


def _loop(name: str, joints: tuple[Joint, ...], tree: Tree, closures: tuple[Closure, ...], extent: float) -> KinematicLoop:
    """Return the closure as numbers."""
    phi = ca.vertcat(ca.SX(0, 1), *[closure.residual for closure in closures])
    return KinematicLoop(
        name=name,
        joints=joints,
        coordinates=tree.coordinates,
        closures=closures,
        unit=unit_steps(joints, extent),
        function=ca.Function("loop", [tree.q], [ca.densify(phi), ca.jacobian(phi, tree.q)]),
    )
