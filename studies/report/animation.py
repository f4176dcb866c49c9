"""The animation of a mechanism: its bodies as sticks, drawn in a plane if all of them move in parallel planes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.joint_frames import joint_frames
from linkplan.models.poses.skeleton import Stick, sticks, view
from linkplan.models.tree.coordinates import joint_label
from linkplan.studies.output.directions import direction_name
from linkplan.studies.output.document import Animation, Body, Ghost
from linkplan.studies.output.numbers import rounded, times
from linkplan.studies.report.drives import drives_of


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Run:
    """A tracked motion: poses (n, n_q) and the applied efforts (n, n_u) [N.m or N]."""

    poses: np.ndarray
    effort: np.ndarray


def frames_of(mechanism: Mechanism, runs: int = 1) -> int:
    """Return the number of frames of an animation that draws a mechanism `runs` times.

    The page interpolates linearly between frames. An animation has at most about 120,000 numbers, to keep the page small.
    """
    numbers_per_frame = 9 * mechanism.model.nbody * runs
    return int(np.clip(120_000 // numbers_per_frame, 41, 201))


def animation(
    mechanism: Mechanism,
    title: str,
    group: str,
    time_s: np.ndarray,
    poses: np.ndarray,
    *,
    effort: np.ndarray | None = None,
    effort_limit: np.ndarray | None = None,
    ghosts: Mapping[str, Run] | None = None,
    sites: Mapping[str, int] | None = None,
    period: float | None = None,
    planned: str = "planned",
    unit: str = "s",
) -> Animation:
    """Return the animation of a mechanism.

    Args:
        mechanism: to draw.
        title: of the block.
        group: of the cursor that sets the animation's instant.
        time_s: (n,) [s].
        poses: (n, n_q), closed.
        effort: (n, n_u) [N.m or N] of the actuators.
        effort_limit: (n_u, 2), the actuators' limits.
        ghosts: other runs at the same instants, by name.
        sites: indices of the MuJoCo sites whose paths are drawn, by name.
        period: of a periodic motion [s].
        planned: name of the solid drawing in the legend.
        unit: of `time_s`, if it is another quantity than time.
    """
    drawn = sticks(mechanism, poses)
    right, up = view(mechanism.model)
    flat = _is_flat(mechanism, drawn, np.cross(right, up))
    frame = np.stack([right, up]) if flat else np.eye(3)
    joints = joint_frames(mechanism, poses)
    names = [joint_label(mechanism.model, index) for index in range(mechanism.model.njnt)]
    places = {name: places_of(mechanism, index, poses) @ frame.T for name, index in (sites or {}).items()}
    labels = [(name, rounded(joints.anchors[:, k] @ frame.T)) for k, name in enumerate(names)]
    labels += [(name, rounded(place)) for name, place in places.items()]
    drives = [] if effort is None else drives_of(mechanism, poses, effort, effort_limit, frame)
    return Animation(
        title=title,
        group=group,
        dimension=2 if flat else 3,
        axes=(direction_name(right), direction_name(up)),
        times=times(time_s),
        bodies=_bodies(drawn, frame),
        ghosts=[
            Ghost(
                name=name,
                bodies=_bodies(sticks(mechanism, run.poses), frame),
                drives=drives_of(mechanism, run.poses, run.effort, effort_limit, frame),
            )
            for name, run in (ghosts or {}).items()
        ],
        drives=drives,
        labels=labels,
        paths=[(name, rounded(place)) for name, place in places.items()],
        planned=planned,
        period=period,
        unit=unit,
    )


def _is_flat(mechanism: Mechanism, drawn: tuple[Stick, ...], across: np.ndarray) -> bool:
    """Tell if every pin keeps its depth along the motion, to a millionth of the mechanism's extent."""
    return all(float(np.ptp(stick.places @ across, axis=0).max()) <= 1e-6 * mechanism.extent_m for stick in drawn)


def _bodies(drawn: tuple[Stick, ...], frame: np.ndarray) -> list[Body]:
    found = []
    for stick in drawn:
        points = stick.places @ frame.T
        flat = points.reshape(len(points), -1)
        found.append(Body(name=stick.body, fixed=stick.fixed, n_pins=points.shape[1], points=rounded(flat)))
    return found
