"""A motion at any times, in the units of files: positions and speeds of all joints, efforts, sites."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.turning import whole_turns
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import AXES
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MotionTable:
    """A motion at times (n,) [s]: by joint [deg or m, and per second], by actuator [N.m or N], by site (n, 3) [m].

    `acceleration` covers the independent joints only. `unit` is the unit of positions by joint, `effort_unit` the unit by
    actuator. `site` are the sites that the problem names, in the world's frame.
    """

    time_s: np.ndarray
    position: dict[str, np.ndarray]
    speed: dict[str, np.ndarray]
    acceleration: dict[str, np.ndarray]
    effort: dict[str, np.ndarray]
    unit: dict[str, str]
    effort_unit: dict[str, str]
    site: dict[str, np.ndarray]

    def single(self) -> "MotionTable":
        """Return the first row, with numbers instead of arrays."""

        def first(values: dict[str, np.ndarray]) -> dict:
            return {name: float(x[0]) for name, x in values.items()}

        return replace(
            self,
            time_s=float(self.time_s[0]),
            position=first(self.position),
            speed=first(self.speed),
            acceleration=first(self.acceleration),
            effort=first(self.effort),
            site={name: place[0] for name, place in self.site.items()},
        )

    def columns(self) -> dict[str, np.ndarray]:
        """Return all columns (n,) with units in their headers: time_s, O_deg, O_deg_s, ..., act_O_Nm, foot_x_m."""
        found = {"time_s": self.time_s}
        for name, values in self.position.items():
            found[f"{name}_{self.unit[name]}"] = values
            found[f"{name}_{self.unit[name]}_s"] = self.speed[name]
        found |= {f"{name}_{self.unit[name]}_s2": values for name, values in self.acceleration.items()}
        found |= {f"{name}_{self.effort_unit[name].replace('.', '')}": values for name, values in self.effort.items()}
        for name, place in self.site.items():
            heads = [f"{name}_{axis}_m" for axis in AXES]
            taken = any(head in found for head in heads)  # by a slide of that name
            found |= {f"site_{head}" if taken else head: place[:, k] for k, head in enumerate(heads)}
        return found

    def named_arrays(self) -> tuple[dict, dict]:
        """Return the variables and coordinates of a data set, each as the names of its dimensions and its values."""
        joints, actuators = list(self.position), list(self.effort)
        variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = {
            "position": (("time_s", "joint"), np.column_stack([self.position[name] for name in joints])),
            "speed": (("time_s", "joint"), np.column_stack([self.speed[name] for name in joints])),
            "effort": (("time_s", "actuator"), np.column_stack([self.effort[name] for name in actuators])),
        }
        coordinates = {
            "time_s": self.time_s,
            "joint": joints,
            "joint_unit": ("joint", [self.unit[name] for name in joints]),
            "actuator": actuators,
            "actuator_unit": ("actuator", [self.effort_unit[name] for name in actuators]),
        }
        if self.site:
            variables["site"] = (("time_s", "site_name", "axis"), np.stack(list(self.site.values()), axis=1))
            coordinates |= {"site_name": list(self.site), "axis": list(AXES)}
        return variables, coordinates


def sample_motion(problem: Problem, trajectory: Trajectory, time_s: object = None, *, jumps: bool = False) -> MotionTable:
    """Return a motion at times (n,) [s], or at a single time as numbers; otherwise as `motion_table`.

    Raises:
        ProblemError: for times that are not finite numbers.
        AssemblyError: when the loops do not close along the motion.
    """
    try:
        time = None if time_s is None else np.asarray(time_s, dtype=float)
    except (TypeError, ValueError, OverflowError):
        time = np.full((), np.nan)
    if time is not None and (time.ndim > 1 or not np.all(np.isfinite(time))):
        raise ProblemError(f"times are finite numbers of seconds, one or a row of them, got {time_s!r}")
    table = motion_table(problem, trajectory, None if time is None else np.atleast_1d(time), jumps=jumps)
    return table.single() if time is not None and time.ndim == 0 else table


def motion_table(
    problem: Problem, trajectory: Trajectory, time_s: np.ndarray | None = None, *, jumps: bool = False
) -> MotionTable:
    """Return a motion at times (n,) [s], in any order; by default at ten times per interval.

    The default times increase strictly, and a break between intervals has the later interval's values. With `jumps` it
    appears twice, just before and at the break, to show jumps of efforts.

    Beyond its ends a periodic motion is continued, with its turns. Any other motion rests there under the effort of the
    nearer end.

    Raises:
        AssemblyError: when the loops do not close along the motion.
    """
    mechanism = problem.mechanism
    dense = trajectory.dense_times(10)  # near enough to follow the loops from sample to sample
    begin, end = trajectory.breaks_s[0], trajectory.breaks_s[-1]
    time = (dense if jumps else _single_valued(dense)) if time_s is None else np.asarray(time_s, dtype=float)
    within = begin + np.mod(time - begin, end - begin) if trajectory.periodic else np.clip(time, begin, end)
    # Loops are followed along the whole motion, so the order and distance of the given times do not matter.
    along, back = np.unique(np.concatenate([dense, within]), return_inverse=True)
    poses = follow(mechanism, trajectory.position_at(along), trajectory.start_pose)
    gone = whole_turns(mechanism, poses[-1] - poses[0]) if np.any(trajectory.advance) else np.zeros(mechanism.n_q)
    q = poses[back[len(dense) :]] + trajectory.periods_at(time)[:, None] * gone
    rates = joint_rates(mechanism, q, trajectory.velocity_at(time))
    accelerations, efforts = trajectory.acceleration_at(time), trajectory.effort_at(time)

    def shown(joints, values: np.ndarray) -> dict[str, np.ndarray]:
        return {j.name: np.degrees(x) if j.kind == "hinge" else x for j, x in zip(joints, values.T, strict=True)}

    return MotionTable(
        time_s=time,
        position=shown(mechanism.joints, q),
        speed=shown(mechanism.joints, rates),
        acceleration=shown(mechanism.independent_joints, accelerations),
        effort={actuator.name: u for actuator, u in zip(mechanism.actuators, efforts.T, strict=True)},
        unit={joint.name: joint.unit for joint in mechanism.joints},
        effort_unit={actuator.name: actuator.unit for actuator in mechanism.actuators},
        site={name: places_of(mechanism, index, q) for name, index in problem.sites.items()},
    )


def _single_valued(dense: np.ndarray) -> np.ndarray:
    """Return increasing times (n,) without near duplicates; of two close times, the later stays."""
    hair = 1e-9 * (dense[-1] - dense[0])  # twelve digits in a table still distinguish them
    kept = [float(dense[-1])]
    for time in dense[-2::-1]:
        if kept[-1] - time > hair:
            kept.append(float(time))
    return np.array(kept[::-1])
