"""A plan's runs in MuJoCo's interactive viewer: gains set by keys, with the ghost and the efforts."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import mujoco
import numpy as np

from linkplan.controllers.controls import Controls
from linkplan.controllers.playback import Rows, Shown
from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import Tracking
from linkplan.studies.compare.compare import lqr_settings, tracking_reference
from linkplan.studies.render.caption import effort_lines
from linkplan.studies.render.framing import framed, own_direction
from linkplan.studies.render.motion import TrackedMotion, tracked_motion
from linkplan.studies.render.mujoco_painter import add_figure, add_shapes
from linkplan.studies.render.scenes import all_points, film_scenes, place_bodies


def run_maker(plan: Plan) -> Callable[[Controls], Shown]:
    """Return the function that runs a plan with a tracker and gains."""
    reference = tracking_reference(plan)
    settings = lqr_settings(plan, reference)

    def make(controls: Controls) -> Shown:
        """Run the tracker in MuJoCo."""
        tracking = with_gains(settings, controls.kp_factor, controls.kd_factor)
        with_them = replace(plan, problem=plan.problem.varied(tracking=tracking))
        motion = tracked_motion(with_them, controls.tracker, reference)
        return shown(motion, lambda k: _words(motion, tracking, controls, k))

    return make


def with_gains(tracking: Tracking, kp_factor: float, kd_factor: float) -> Tracking:
    """Return settings with multiplied gains; for LQR, the position and velocity errors of unit cost are divided instead."""

    def times(gain, factor: float):
        return {name: factor * one for name, one in gain.items()} if isinstance(gain, Mapping) else factor * gain

    if kp_factor == kd_factor == 1.0:
        return tracking
    return tracking.replace(
        kp=times(tracking.kp, kp_factor),
        kd=times(tracking.kd, kd_factor),
        lqr_position_deg=times(tracking.lqr_position_deg, 1 / kp_factor),
        lqr_position_m=times(tracking.lqr_position_m, 1 / kp_factor),
        lqr_velocity_deg_s=times(tracking.lqr_velocity_deg_s, 1 / kd_factor),
        lqr_velocity_m_s=times(tracking.lqr_velocity_m_s, 1 / kd_factor),
    )


def shown(motion: TrackedMotion, words: Callable[[int], Rows]) -> Shown:
    """Return a motion for the viewer."""
    model = motion.mechanism.model
    direction, data, option = own_direction(model), mujoco.MjData(model), mujoco.MjvOption()

    def decorate(scene, k: int, ghost: bool) -> None:
        """Add the skeleton, the payload, the ghost and the efforts of instant k."""
        (picture,) = film_scenes(motion, np.array([k]), direction)
        planned, own = picture.figures
        add_shapes(scene, (*own.shapes, *picture.efforts))
        if ghost:
            place_bodies(model, data, planned.qpos)
            add_figure(scene, model, data, option, planned)

    return Shown(time_s=motion.time_s, pose=motion.pose, decorate=decorate, words=words, stable=motion.stable)


def aim(plan: Plan, tracker: str) -> Callable[[mujoco.MjvCamera], None]:
    """Return the function that points MuJoCo's camera at a plan's whole motion."""
    motion = tracked_motion(plan, tracker)
    model = motion.mechanism.model
    direction = own_direction(model)
    return framed(all_points(motion, direction), *direction, float(np.radians(model.vis.global_.fovy)), 1.5).aim


def _words(motion: TrackedMotion, tracking: Tracking, controls: Controls, k: int) -> Rows:
    factors = [f"  (x{factor:.3g})" if factor != 1.0 else "" for factor in (controls.kp_factor, controls.kd_factor)]
    if BUILT_IN[controls.tracker].by_errors:
        hinge = any(joint.kind == "hinge" for joint in motion.mechanism.independent_joints)
        position = f"{_gain_text(tracking.lqr_position_deg if hinge else tracking.lqr_position_m)} {'deg' if hinge else 'm'}"
        velocity = _gain_text(tracking.lqr_velocity_deg_s if hinge else tracking.lqr_velocity_m_s)
        velocity += " deg/s" if hinge else " m/s"
        gains = [("weighs 1: position", position + factors[0]), ("weighs 1: speed", velocity + factors[1])]
    else:
        gains = [("kp", _gain_text(tracking.kp) + factors[0]), ("kd", _gain_text(tracking.kd) + factors[1])]
    efforts = [(name, said) for name, _, said in (text.partition(": ") for text, _ in effort_lines(motion, k))]
    stable = [] if motion.stable else [("", "unstable")]
    return [(motion.name, f"t = {motion.time_s[k]:.4f} s"), ("tracker", motion.tracker), *gains, *efforts, *stable]


def _gain_text(gain) -> str:
    return ", ".join(f"{one:.4g}" for one in (gain.values() if isinstance(gain, Mapping) else [gain]))
