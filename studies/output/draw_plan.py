"""A plan over time: its motion, sampled; its plots; and its figure with the mechanism or the paths of its sites."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import accelerations, jerks, sampled, site_motion
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.planner.limits.samples import Samples
from linkplan.planner.plan.folder import write_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.sites import AXES, angles_of
from linkplan.studies.output.document import Plot
from linkplan.studies.output.figure_spec import FigureSpec, side_by_side
from linkplan.studies.output.lines import TIME, Line, plots

# A position [rad or m], speed [per second] or effort [N.m or N] that is never larger is zero: it consists of rounding
# errors.
LEAST_SHOWN = 1e-9
_SITE_RATES = ("speed", "acceleration", "jerk")  # the derivatives of a site's place, in order


def drawn_motion(plan: Plan) -> Samples:
    """Return a plan's motion at instants spread over every interval: 12 steps each, but 300 to 700 steps in all.

    At a jump in effort there is an instant on each side. Efforts that consist of rounding errors are zero.

    Raises:
        AssemblyError: if the kinematic loops do not close along the motion.
    """
    trajectory = plan.require_motion("draw")
    u = trajectory.effort
    trajectory = replace(trajectory, effort=np.where(np.abs(u).max(axis=(0, 1)) > LEAST_SHOWN, u, 0.0))
    n = len(trajectory.breaks_s) - 1
    points = np.linspace(0.0, 1.0, int(np.clip(max(12, 300 // n), 1, max(2, 700 // n))) + 1)
    points[-1] = 1.0 - 1e-12  # the side of the jump that belongs to this interval
    time = trajectory.times_at(points)
    q = follow(plan.problem.mechanism, trajectory.position_at(time), trajectory.start_pose)
    return Samples(problem=plan.problem, trajectory=trajectory, points=points, time=time, q=q)


def plan_figure(plan: Plan) -> FigureSpec:
    """Return the figure of a plan's positions, speeds and efforts."""
    motion = drawn_motion(plan)
    drawn = time_plots(plan, motion)
    shown = [*drawn["position"], *drawn["speed"], *drawn["effort"]]
    poses = motion.q[np.linspace(0, len(motion.q) - 1, 5).astype(int)]

    def mechanism(axes) -> None:
        from linkplan.studies.output.draw_bodies import draw_poses, draw_sites  # these modules load matplotlib

        if plan.problem.sites:
            draw_sites(axes, plan)
        else:
            draw_poses(axes, plan.problem.mechanism, poses, "the end of the motion")

    title = f"{plan.problem.name}: {plan.message}"
    return FigureSpec(panels=side_by_side(shown, [mechanism]), title=title, columns=2, panel_in=(6.2, 2.7))


def time_plots(plan: Plan, motion: Samples, group: str = "", period: float | None = None) -> dict[str, list[Plot]]:
    """Return the plots of a plan's motion over time, by the quantity that they show."""
    mechanism, limits, time = plan.problem.mechanism, plan.problem.limits, motion.time
    independent, dependent = list(mechanism.independent), list(mechanism.dependent)
    reference = plan.problem.reference_over(time[-1] - time[0])

    def joints(which: Sequence[int], key: str, values: np.ndarray, per: str = "") -> list[Line]:
        return [
            Line(
                name=(joint := mechanism.joints[k]).name,
                values=joint.shown(values[:, k]),
                unit=f"{joint.unit}{per}",
                limits=tuple(joint.shown(getattr(limits, key)[k]).tolist()),
            )
            for k in which
            if np.any(np.abs(values[:, k]) > LEAST_SHOWN * max(1.0, np.abs(values).max()))
        ]

    def actuators(key: str, values: np.ndarray, unit: str = "") -> list[Line]:
        every = zip(mechanism.actuators, values.T, getattr(limits, key), strict=True)
        return [Line(name=one.name, values=of, unit=unit or one.unit, limits=tuple(ends)) for one, of, ends in every]

    positions = joints(independent, "position", motion.q)
    if reference is not None:
        wanted = reference.derivative(time)
        positions += [
            Line(name=f"{joint.name}, reference", values=joint.shown(x), unit=joint.unit, look="dash", colour=None)
            for joint, x in zip(mechanism.independent_joints, wanted.T, strict=True)
        ]
    rates, powers, every = motion.joint_rates, motion.u * motion.actuator_speeds, range(mechanism.n_q)
    bends = accelerations(mechanism, motion.q, motion.v, motion.a)
    changes = jerks(mechanism, motion.q, motion.v, motion.a, motion.jerk)
    drawn: tuple[tuple[str, str, str, list[Line]], ...] = (
        ("position", "Position of the independent joints", "position", positions),
        ("dependent position", "Position of the dependent joints", "position", joints(dependent, "position", motion.q)),
        ("site", "Sites", "place", _site_lines(plan, motion)),
        ("site", "Angles of bodies", "angle", _body_lines(plan, motion)),
        ("speed", "Speed of the independent joints", "speed", joints(independent, "speed", rates, "/s")),
        ("dependent speed", "Speed of the dependent joints", "speed", joints(dependent, "speed", rates, "/s")),
        ("acceleration", "Acceleration of the joints", "acceleration", joints(every, "acceleration", bends, "/s2")),
        ("jerk", "Jerk of the joints between jumps of acceleration", "jerk", joints(every, "jerk", changes, "/s3")),
        *((key, f"{key.capitalize()} of the sites", key, _site_rates(plan, motion, key)) for key in _SITE_RATES),
        ("effort", "Effort of the actuators", "effort", actuators("effort", motion.u)),
        ("power", "Mechanical power of the actuators", "power", actuators("power", powers, "W")),
    )
    found: dict[str, list[Plot]] = {}
    for key, title, what, lines in drawn:
        found.setdefault(key, []).extend(plots(title, what, TIME, time, lines, group=group, period=period))
    return found


def force_plots(plan: Plan, motion: Samples, group: str = "", period: float | None = None) -> list[Plot]:
    """Return the plots of the forces and moments in all pins (of closures and of the tree) and on the frame."""
    mechanism, limits, at = plan.problem.mechanism, plan.problem.limits, motion.joint_forces
    most = dict(zip(mechanism.closure_names, limits.closure_force.tolist(), strict=True)) | dict(limits.pin_force)
    forces = [
        Line(name=name, values=of, unit="N", limits=(-np.inf, most.get(name, np.inf))) for name, of in at.force.items()
    ]
    moments = [Line(name=name, values=of, unit="N.m") for name, of in at.moment.items()]
    shaking = [Line(name=axis, values=at.on_frame[:, k], unit="N") for k, axis in enumerate(AXES)]
    turning = [Line(name=axis, values=at.on_frame[:, 3 + k], unit="N.m") for k, axis in enumerate(AXES)]
    drawn = (
        ("Force in the pins", "force", forces),
        ("Moment in the pins across their axes", "moment", moments),
        ("Force on the frame", "force", [line for line in shaking if np.any(line.values)]),
        ("Moment on the frame about the world's origin", "moment", [line for line in turning if np.any(line.values)]),
        ("Forces over time on sites", "force", _applied(mechanism, motion)),
    )
    return [
        plot
        for title, what, lines in drawn
        for plot in plots(title, what, TIME, motion.time, lines, group=group, period=period)
    ]


def _applied(mechanism: Mechanism, motion: Samples) -> list[Line]:
    """Return the components of the forces over time that are not always zero."""
    if mechanism.forces is None:
        return []
    heads = [f"{site} {axis}" for site in mechanism.forces.sites for axis in AXES]
    (forces,) = motion.forces
    return [Line(name=head, values=values, unit="N") for head, values in zip(heads, forces.T, strict=True) if np.any(values)]


def _site_lines(plan: Plan, motion: Samples) -> list[Line]:
    """Return the moving coordinates of the sites that a problem names, in millimetres."""
    mechanism, lines = plan.problem.mechanism, []
    for name, index in plan.problem.sites.items():
        places = places_of(mechanism, index, motion.q)
        for axis, values in zip("xyz", places.T, strict=True):
            if np.ptp(values) > 1e-6 * mechanism.extent_m:
                lines.append(Line(name=f"{name}, {axis}", values=1e3 * values, unit="mm"))
    return lines


def _site_rates(plan: Plan, motion: Samples, key: str) -> list[Line]:
    """Return the size of a derivative of the sites that a problem names, with its limits."""
    order, mechanism = _SITE_RATES.index(key) + 1, plan.problem.mechanism
    if not plan.problem.sites:
        return []
    values = sampled(site_motion(mechanism, order), *(motion.q, motion.v, motion.a, motion.jerk)[: max(3, order + 1)])
    most, unit = getattr(plan.problem.limits, f"site_{key}"), f"m/s{order if order > 1 else ''}"
    return [
        Line(
            name=name,
            values=np.linalg.norm(values[:, :, index], axis=1),
            unit=unit,
            limits=(-np.inf, most.get(name, np.inf)),
        )
        for name, index in plan.problem.sites.items()
    ]


def _body_lines(plan: Plan, motion: Samples) -> list[Line]:
    """Return the angles of the bodies that a problem names, with their limits, in degrees."""
    problem = plan.problem
    limits = {one.body: (float(np.degrees(one.low)), float(np.degrees(one.high))) for one in problem.limits.body}
    return [
        Line(
            name=name,
            values=np.degrees(angles_of(problem.mechanism, index, motion.q)),
            unit="deg",
            limits=limits.get(name, (-np.inf, np.inf)),
        )
        for name, index in problem.bodies.items()
    ]


def save_plan(plan: Plan, place: Path, target: Path | None = None, *, jumps: bool = False, parquet: bool = False) -> None:
    """Write a plan and its figure into an empty folder, which the caller moves to `target` if it is given."""
    from linkplan.studies.output.figure import save_figures

    write_plan(plan, place, target, jumps=jumps, parquet=parquet)
    save_figures([("plan", plan_figure(plan))], place)
