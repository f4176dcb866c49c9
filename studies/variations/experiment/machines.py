"""Conversion of one sample's values, in a problem file's units, to a machine's imperfections in SI units."""

from collections.abc import Mapping, Sequence

import numpy as np

from linkplan.controllers.imperfections.imperfections import (
    Clock,
    Drives,
    Imperfections,
    Machine,
    Push,
    Sensors,
    Start,
)
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.imperfections import ImperfectionFactors


def machine_of(
    section: ImperfectionFactors, values: Sequence[float], mechanism: Mechanism, noise_seed: tuple[int, ...]
) -> Imperfections:
    """Return the machine with a value for each of the section's factors, and with the noise of a seed."""
    given: dict[str, dict[str, float]] = {}
    for factor, value in zip(section.factors, values, strict=True):
        given.setdefault(factor.key, {})[factor.name] = float(value)
    one = {key: found[""] for key, found in given.items() if "" in found}
    independent = [joint.name for joint in mechanism.independent_joints]
    joints = [joint.name for joint in mechanism.joints]
    actuators = [actuator.name for actuator in mechanism.actuators]

    def each(names: list[str], key: str, neutral: float) -> np.ndarray:
        return np.array([given.get(key, {}).get(name, neutral) for name in names])

    def coordinates(stem: str, angle: str = "_deg", length: str = "_m") -> np.ndarray:
        return np.radians(each(independent, stem + angle, 0.0)) + each(independent, stem + length, 0.0)

    machine = Machine(
        viscous=each(joints, "viscous_friction", 0.0),
        coulomb=each(joints, "coulomb_friction", 0.0),
        mass_factor=one.get("payload_mass_factor", 1.0),
        com_shift_m=_vector(one, "payload_com_{}_m"),
        length_factor=given.get("link_length_factor", {}),
        loop_solref=_solref(one, mechanism),
    )
    return Imperfections(
        clock=Clock(
            period_factor=one.get("period_factor", 1.0),
            phase_periods=one.get("phase_periods", 0.0),
            delay_periods=one.get("delay_periods", 0.0),
        ),
        sensors=Sensors(
            resolution=coordinates("encoder_resolution"),
            offset=coordinates("encoder_offset"),
            noise=coordinates("position_noise"),
            velocity_noise=coordinates("velocity_noise", "_deg_s", "_m_s"),
            velocity_filter_hz=one.get("velocity_filter_hz"),
            noise_seed=noise_seed,
        ),
        drives=Drives(
            resolution=each(actuators, "torque_resolution", 0.0),
            constant_factor=each(actuators, "torque_constant_factor", 1.0),
            bandwidth_hz=each(actuators, "torque_bandwidth_hz", np.inf),
            rate_limit=each(actuators, "torque_rate", np.inf),
        ),
        machine=machine,
        start=Start(
            position_error=coordinates("start_error"),
            velocity_error=coordinates("start_velocity_error", "_deg_s", "_m_s"),
        ),
        pushes=_pushes(section, one),
    )


def _vector(one: Mapping[str, float], key: str) -> np.ndarray | None:
    names = [key.format(axis) for axis in "xyz"]
    return np.array([one.get(name, 0.0) for name in names]) if any(name in one for name in names) else None


def _solref(one: Mapping[str, float], mechanism: Mechanism) -> tuple[float, float] | None:
    names = ("loop_time_constant_s", "loop_damping_ratio")
    if not any(name in one for name in names) or not mechanism.model.neq:
        return None
    own = mechanism.model.eq_solref[0]
    return one.get(names[0], float(own[0])), one.get(names[1], float(own[1]))


def _pushes(section: ImperfectionFactors, one: Mapping[str, float]) -> tuple[Push, ...]:
    start, duration = one.get("push_start_s", 0.0), one.get("push_duration_s", 0.0)
    pushes = []
    if section.push_body is not None:
        force = _vector(one, "push_force_{}_n")
        pushes.append(Push(start_s=start, duration_s=duration, body=section.push_body, force=force))
    if section.push_joint is not None:
        effort = one.get("push_effort", 0.0)
        pushes.append(Push(start_s=start, duration_s=duration, joint=section.push_joint, effort=effort))
    return tuple(pushes)
