"""The default imperfections of an experiment, for a problem file without any: those of a carefully built machine.

They describe a driven joint with an absolute encoder of 19 bits, a current loop of some hundred hertz and a controller with
about one period of delay. docs/experiments.md has the table.
"""

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.plan import Plan


def default_imperfections(plan: Plan) -> dict:
    """Return the table [imperfections] of a carefully built machine for the plan's mechanism."""
    mechanism = plan.problem.mechanism
    limit = np.abs(plan.problem.limits.actuators_effort).max(axis=1)
    peak = np.asarray(plan.certificate.peak_effort, dtype=float)
    size = np.where(np.isfinite(limit), limit, np.maximum(peak, 1e-9))
    table: dict = {
        "period_factor": {"normal": [1.0, 1e-4]},
        "delay_periods": [0.5, 1.5],
        "velocity_filter_hz": 1000.0,
        "torque_bandwidth_hz": [500.0, 1500.0],
        "torque_constant_factor": {"normal": [1.0, 0.03]},
        "payload_mass_factor": [0.9, 1.1],
        "link_length_factor": {"normal": [1.0, 2e-4]},
    }
    kinds = {joint.kind for joint in mechanism.independent_joints}
    if "hinge" in kinds:
        table |= {
            "encoder_resolution_deg": 360.0 / 2**19,
            "encoder_offset_deg": {"normal": [0.0, 0.02]},
            "start_error_deg": {"normal": [0.0, 0.05]},
        }
    if "slide" in kinds:
        step = mechanism.extent_m / 2**16
        table |= {
            "encoder_resolution_m": step,
            "encoder_offset_m": {"normal": [0.0, 10 * step]},
            "start_error_m": {"normal": [0.0, 20 * step]},
        }
    actuators = list(zip(mechanism.actuators, size.tolist(), strict=True))
    # A 12-bit command of both signs; friction up to 2 % of the effort limit, or of the planned peak without a limit.
    table["torque_resolution"] = {actuator.name: most / 2048 for actuator, most in actuators}
    driven = {joint: most for actuator, most in actuators if (joint := _joint(mechanism, actuator)) is not None}
    if driven:
        table["coulomb_friction"] = {joint: [0.0, 0.02 * most] for joint, most in driven.items()}
    return table


def _joint(mechanism: Mechanism, actuator) -> str | None:
    return None if actuator.joint is None else mechanism.joints[actuator.joint].name
