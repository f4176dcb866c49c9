"""The output of `linkplan tune`: a JSON record, the [tracking] table of a problem file, and a text table."""

import numpy as np

from linkplan.studies.output.tables import table
from linkplan.studies.tune.tune import Tuning


def motor_gains(tuning: Tuning) -> dict:
    """Return PD gains on the motor's side of the transmission: the motor's effort over the motor's position."""
    actuator = tuning.mechanism.actuators[0]
    settings = tuning.best.settings
    return {"gear": actuator.gear, "kp": settings.kp / actuator.gear**2, "kd": settings.kd / actuator.gear**2}


def tune_record(tuning: Tuning) -> dict:
    """Return the JSON record of `linkplan tune`."""
    settings, best = tuning.best.settings, tuning.best
    joint = tuning.mechanism.independent_joints[0]
    gains: dict = {"period_s": tuning.timing.period_s, "delay_s": tuning.timing.delay_s}
    if tuning.law == "lqr":
        unit = "deg" if joint.kind == "hinge" else "m"
        position, velocity = (float(weight[0]) for weight in settings.lqr_errors([joint]))
        gains |= {f"lqr_position_{unit}": joint.shown(position), f"lqr_velocity_{unit}_s": joint.shown(velocity)}
    else:
        gains |= {"kp": settings.kp, "kd": settings.kd, "motor_side": motor_gains(tuning)}
    return {
        "mechanism": tuning.mechanism.name,
        "tracker": tuning.law,
        "found": tuning.found,
        "message": tuning.message,
        "wanted": {
            "bandwidth_hz": tuning.wanted.bandwidth_hz,
            "phase_margin_deg": tuning.wanted.phase_margin_deg,
            "sensitivity_peak": tuning.wanted.sensitivity_peak if np.isfinite(tuning.wanted.sensitivity_peak) else None,
            "settling_s": tuning.wanted.longest_settling_s,
            "damping_ratio": tuning.wanted.damping_ratio,
        },
        "gains": gains,
        "points": [
            {f"position_{joint.unit}": joint.shown(point.state[0]), **bounds.record(), "stiffness_at_rest": stiffness}
            for point, bounds, stiffness in zip(tuning.points, best.bounds, best.stiffness, strict=True)
        ],
    }


def tracking_values(tuning: Tuning) -> dict:
    """Return the gains under the keys of the [tracking] table of a problem file."""
    settings, joint = tuning.best.settings, tuning.mechanism.independent_joints[0]
    values = {"kp": settings.kp, "kd": settings.kd}
    if tuning.law == "lqr":
        position, velocity = (joint.shown(float(weight[0])) for weight in settings.lqr_errors([joint]))
        values = {f"lqr_position_{joint.unit}": position, f"lqr_velocity_{joint.unit}_s": velocity}
    values |= {"period_s": settings.period_s}
    if settings.delay_periods and float(settings.delay_periods).is_integer():
        values |= {"delay_periods": int(settings.delay_periods)}
    return values


def tracking_table(tuning: Tuning) -> str:
    """Return the gains as the text of the [tracking] table of a problem file."""
    values = tracking_values(tuning)
    lines = [f"# {tuning.message}", "[tracking]", *(f"{key} = {value:.6g}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def tune_text(tuning: Tuning) -> str:
    """Return the gains in the joint's and the motor's units, and the margins at every pose, as text."""
    mechanism, settings = tuning.mechanism, tuning.best.settings
    joint, actuator = mechanism.independent_joints[0], mechanism.actuators[0]
    turn = "rad" if joint.kind == "hinge" else "m"
    force = "N.m" if joint.kind == "hinge" else "N"
    lines = [tuning.message, ""]
    if tuning.law == "lqr":
        position, velocity = (joint.shown(float(weight[0])) for weight in settings.lqr_errors([joint]))
        lines.append(
            f"lqr_position_{joint.unit} = {position:.5g}, lqr_velocity_{joint.unit}_s = {velocity:.5g}"
            " (errors weighted like the full effort limit)"
        )
    else:
        motor = motor_gains(tuning)
        lines.append(f"at the joint: kp = {settings.kp:.5g} {force}/{turn}, kd = {settings.kd:.5g} {force}.s/{turn}")
        lines.append(
            f"at the motor {actuator.name}, gear {motor['gear']:g}: kp = {motor['kp']:.5g}, kd = {motor['kd']:.5g},"
            " its own effort over its own motion"
        )
    rows = [
        [
            f"{joint.said(p.state[0], 5)}",
            m.stable,
            m.bandwidth_hz,
            m.phase_margin_deg,
            m.gain_margin_db,
            m.sensitivity_peak,
            m.settling_s,
            m.damping_ratio,
            stiffness,
        ]
        for p, m, stiffness in zip(tuning.points, tuning.best.bounds, tuning.best.stiffness, strict=True)
    ]
    head = [f"{joint.name} [{joint.unit}]", "stable", "bandwidth -3 dB [Hz]", "PM [deg]", "GM [dB]", "max |S|"]
    head += ["settling [s]", "damping", f"stiffness [{force}/{turn}]"]
    return "\n".join([*lines, "", table(head, rows)])
