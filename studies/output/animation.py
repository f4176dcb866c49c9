"""The animation of a mechanism: its bodies with their shapes, drawn in a plane if all of them move parallel to it."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.skeleton import view
from linkplan.studies.output.bodies import Drawing, bodies_of, drawing_of, floors_of, named_pins
from linkplan.studies.output.document import Animation, Drive, Ghost, Mark
from linkplan.studies.output.draw_plan import LEAST_SHOWN
from linkplan.studies.output.effort_marks import effort_marks
from linkplan.studies.output.numbers import direction_name, rounded, rounded_times


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Run:
    """A tracked motion: poses (n, n_q) and the applied efforts (n, n_u) [N.m or N]."""

    poses: np.ndarray
    effort: np.ndarray


def frames_of(mechanism: Mechanism, runs: int = 1) -> int:
    """Return the number of frames of an animation that draws a mechanism `runs` times.

    The page interpolates linearly between frames. An animation has at most about 120,000 numbers, to keep the page small.
    """
    numbers_per_frame = 13 * mechanism.model.nbody * runs
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
        unit: of `time_s`, if it is not a time.
    """
    right, up = view(mechanism.model)
    drawing = drawing_of(mechanism, poses, (right, up))
    frame, flat = drawing.frame, drawing.flat
    places = {name: places_of(mechanism, index, poses) @ frame.T for name, index in (sites or {}).items()}
    drives = [] if effort is None else drives_of(mechanism, poses, effort, effort_limit, frame)
    return Animation(
        title=title,
        group=group,
        dimension=2 if flat else 3,
        axes=(direction_name(right), direction_name(up)),
        times=rounded_times(time_s),
        bodies=bodies_of(drawing, poses),
        ghosts=[
            Ghost(
                name=name,
                bodies=bodies_of(drawing, run.poses, shaped=False),
                drives=drives_of(mechanism, run.poses, run.effort, effort_limit, frame),
            )
            for name, run in (ghosts or {}).items()
        ],
        drives=drives,
        labels=_labels(drawing, poses, places),
        paths=[(name, rounded(place)) for name, place in places.items()],
        period=period,
        unit=unit,
        floors=floors_of(mechanism) if not flat or abs(up[2] - 1) < 1e-9 else [],
    )


def _labels(drawing: Drawing, poses: np.ndarray, places: Mapping[str, np.ndarray]) -> list[tuple[str, list]]:
    """Return the names of joints, cut pins and named sites with their positions; a name appears once at each place."""
    mechanism = drawing.mechanism
    named = [(name, at @ drawing.frame.T) for name, at in named_pins(mechanism, poses)]
    labels: dict[tuple, tuple[str, list]] = {}
    for name, at in (*named, *places.items()):
        labels.setdefault((name, *np.round(at[0] / mechanism.extent_m, 4)), (name, rounded(at)))
    return list(labels.values())


def drives_of(
    mechanism: Mechanism, poses: np.ndarray, effort: np.ndarray, limit: np.ndarray | None, frame: np.ndarray
) -> list[Drive]:
    """Return the actuators of a mechanism at poses (n, n_q), each with its effort and marks.

    Args:
        mechanism: with the actuators.
        poses: (n, n_q).
        effort: (n, n_u) [N.m or N].
        limit: effort limits (n_u, 2); if None, those of the actuators.
        frame: the drawing's directions as rows: right and up in a plane, or all three in space.
    """
    places: list[list] = [[] for _ in mechanism.actuators]
    data = mujoco.MjData(mechanism.model)
    for qpos in mechanism.qpos_of(poses):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(mechanism.model, data)
        mujoco.mj_comPos(mechanism.model, data)
        mujoco.mj_tendon(mechanism.model, data)
        for j, actuator in enumerate(mechanism.actuators):
            places[j].append(effort_marks(mechanism.model, data, actuator))
    drives = []
    for j, actuator in enumerate(mechanism.actuators):
        ends = mechanism.effort_limit[j] if limit is None else limit[j]
        drives.append(
            Drive(
                name=actuator.name,
                unit=actuator.unit,
                marks=[mark for k in range(len(places[j][0])) if (mark := _drawn(places[j], k, frame)) is not None],
                effort=rounded(np.nan_to_num(np.where(np.abs(effort[:, j]) > LEAST_SHOWN, effort[:, j], 0.0))),
                limits=(_finite(ends[0]), _finite(ends[1])),
            )
        )
    return drives


def _finite(end: float) -> float | None:
    return float(end) if np.isfinite(end) else None


def _drawn(places: list, k: int, frame: np.ndarray) -> Mark | None:
    """Return the k-th mark of an actuator over all frames; None for an arc whose axis lies in the plane of the drawing."""
    shape, parts = places[0][k][0], [marks[k][1] for marks in places]
    if shape == "line":  # a tendon has two more points while it touches a geom; otherwise its last point is repeated
        most = max(len(part) for part in parts)
        lines = np.array([np.pad(part, ((0, most - len(part)), (0, 0)), mode="edge") for part in parts]) @ frame.T
        return Mark(shape=shape, at=rounded(lines.reshape(len(lines), -1)), axis=[])
    at = np.array(parts) @ frame.T
    axis = np.array([marks[k][2] for marks in places])
    if len(frame) == 2 and shape == "arc":
        axis = axis @ np.cross(frame[0], frame[1])[:, None]
        if np.abs(axis).max() < 1e-6:
            return None
    elif len(frame) == 2:
        axis = axis @ frame.T
    return Mark(shape=shape, at=rounded(at), axis=rounded(axis))
