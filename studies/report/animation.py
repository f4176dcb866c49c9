"""A mechanism in motion as a block: its bodies as sticks, flat where all of them move in parallel planes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.joint_frames import joint_frames
from linkplan.models.poses.skeleton import Stick, sticks, view
from linkplan.models.tree.coordinates import joint_label
from linkplan.studies.output.directions import direction_said
from linkplan.studies.report.document import Animation, Body, Ghost
from linkplan.studies.report.drives import drives_of
from linkplan.studies.report.numbers import rounded, times

# Frames of an animation: between them the page goes in straight lines.
FRAMES = 201
# Of mechanisms with many bodies there are fewer frames, so that an animation keeps to about so many numbers.
_NUMBERS, _FEWEST_FRAMES = 120_000, 41
# Depths that change by less than this share of the mechanism's extent do not change: a motion in a plane.
_FLAT = 1e-6


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Run:
    """A motion as it was tracked: poses (n, n_q), and the efforts (n, n_u) [N.m or N] that acted."""

    poses: np.ndarray
    effort: np.ndarray


def frames_of(mechanism: Mechanism, runs: int = 1) -> int:
    """Return how many frames an animation of a mechanism has, which is drawn `runs` times."""
    each = 9 * mechanism.model.nbody * runs
    return int(np.clip(_NUMBERS // each, _FEWEST_FRAMES, FRAMES))


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
        mechanism: what moves.
        title: of the block.
        group: whose cursor is the animation's instant.
        time_s: (n,) [s].
        poses: (n, n_q), closed.
        effort: (n, n_u) [N.m or N] of the actuators.
        effort_limit: (n_u, 2) of them.
        ghosts: other runs at the same instants, by name.
        sites: MuJoCo's sites by name, whose paths are drawn.
        period: of a motion that repeats [s].
        planned: what the solid drawing is called beside ghosts.
        unit: of `time_s`, where the mechanism is drawn over another quantity than time.
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
        axes=(direction_said(right), direction_said(up)),
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
    """Return whether no pin's depth changes along the motion."""
    return all(float(np.ptp(stick.places @ across, axis=0).max()) <= _FLAT * mechanism.extent_m for stick in drawn)


def _bodies(drawn: tuple[Stick, ...], frame: np.ndarray) -> list[Body]:
    found = []
    for stick in drawn:
        points = stick.places @ frame.T
        flat = points.reshape(len(points), -1)
        found.append(Body(name=stick.body, fixed=stick.fixed, n_pins=points.shape[1], points=rounded(flat)))
    return found
