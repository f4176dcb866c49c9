"""Examples of the keys of a problem file that have no single default, for new problem files. Quick to import.

Types, units, defaults and meanings are defined in the sections; a test checks that this table has the same keys. Examples
have placeholders in braces for a mechanism's names, {hinge}, {slide}, {actuator}, ...; see `NEEDS`.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from linkplan.planner.keys.quantities import QUANTITIES


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A key's value as TOML, and the items of `NEEDS` that a mechanism must have for it."""

    text: str
    needs: tuple[str, ...] = ()


# Kinds of objects that an example needs: joints of either kind, independent joints of either kind, ...
NEEDS = ("hinge", "slide", "free_hinge", "free_slide", "actuator", "closure", "site", "body", "fully_driven")


def _example(text: str, needs: str = "") -> Example:
    return Example(text=text, needs=tuple(needs.split()))


# The need of a quantity, by the kind of object that it belongs to.
_OF = {"hinge": "free_hinge", "slide": "free_slide", "actuator": "actuator", "body": "body"}
# Values for [imperfections]: those of a carefully built machine.
_SIZES = {
    "period_factor": "{ normal = [1.0, 1e-4] }",
    "phase_periods": "[0.0, 1.0]",
    "delay_periods": "[0.5, 1.5]",
    "encoder_resolution_deg": "0.01",
    "encoder_resolution_m": "1e-5",
    "encoder_offset_deg": "{ normal = [0.0, 0.02] }",
    "encoder_offset_m": "{ normal = [0.0, 1e-4] }",
    "position_noise_deg": "0.005",
    "position_noise_m": "1e-5",
    "velocity_noise_deg_s": "1.0",
    "velocity_noise_m_s": "0.01",
    "velocity_filter_hz": "1000.0",
    "torque_resolution": "0.05",
    "torque_bandwidth_hz": "[500.0, 1500.0]",
    "torque_rate": "5000.0",
    "torque_constant_factor": "{ normal = [1.0, 0.03] }",
    "viscous_friction": "{ {joint} = [0.0, 0.05] }",
    "coulomb_friction": "{ {joint} = [0.0, 2.0] }",
    "payload_mass_factor": "[0.9, 1.1]",
    "payload_com_x_m": "[-0.005, 0.005]",
    "payload_com_y_m": "[-0.005, 0.005]",
    "payload_com_z_m": "[-0.005, 0.005]",
    "link_length_factor": "{ normal = [1.0, 2e-4] }",
    "push_start_s": "[0.0, 0.1]",
    "push_duration_s": "0.01",
    "push_force_x_n": "[-20.0, 20.0]",
    "push_force_y_n": "[-20.0, 20.0]",
    "push_force_z_n": "[-20.0, 20.0]",
    "push_effort": "[-5.0, 5.0]",
    "start_error_deg": "{ normal = [0.0, 0.05] }",
    "start_error_m": "{ normal = [0.0, 1e-4] }",
    "start_velocity_error_deg_s": "{ normal = [0.0, 1.0] }",
    "start_velocity_error_m_s": "{ normal = [0.0, 0.01] }",
    "loop_time_constant_s": "0.005",
    "loop_damping_ratio": "1.0",
}
_PAYLOAD = "{ body = {body_name}, mass_kg = 1.0, com_m = [0.0, 0.0, 0.0], inertia_kgm2 = [1e-3, 1e-3, 1e-3] }"
_MOTOR = "{ torque_constant = 0.5, resistance_ohm = 0.1, stall_effort = {effort_high}, {no_load} }"

# By the key's path; the path of [motors] contains the actuator's name.
EXAMPLES: Mapping[str, Example] = {
    "mechanism.model": _example('"{model}"'),
    "mechanism.payload": _example(_PAYLOAD, "body"),
    "mechanism.home_deg": _example("{ {hinge} = {hinge_home} }", "hinge"),
    "mechanism.home_m": _example("{ {slide} = {slide_home} }", "slide"),
    "mechanism.independent": _example("[{independent}]"),
    "mechanism.closure_tolerance_m": _example("1e-6"),
    "mechanism.solref": _example('"stiff"', "closure"),
    "mechanism.friction_transition_deg_s": _example("2.0"),
    "motion.kind": _example('"reach"'),
    "motion.start_deg": _example("{ {free_hinge} = {free_hinge_home} }", "free_hinge"),
    "motion.start_m": _example("{ {free_slide} = {free_slide_home} }", "free_slide"),
    "motion.start_at": _example("{ {site} = {site_home} }", "site"),
    "motion.goal_deg": _example("{ {free_hinge} = {free_hinge_home} }", "free_hinge"),
    "motion.goal_m": _example("{ {free_slide} = {free_slide_home} }", "free_slide"),
    "motion.goal_at": _example("{ {site} = {site_home} }", "site"),
    "motion.start_speed_deg_s": _example("{ {free_hinge} = 0.0 }", "free_hinge"),
    "motion.start_speed_m_s": _example("{ {free_slide} = 0.0 }", "free_slide"),
    "motion.goal_speed_deg_s": _example("{ {free_hinge} = 0.0 }", "free_hinge"),
    "motion.goal_speed_m_s": _example("{ {free_slide} = 0.0 }", "free_slide"),
    "motion.duration_s": _example('"free"'),
    "motion.min_duration_s": _example("0.1"),
    "motion.max_duration_s": _example("10.0"),
    "motion.waypoints": _example("[{ {waypoint} }]"),
    "motion.turns": _example("{ {free_hinge} = 1 }", "free_hinge"),
    "reference.frequency_hz": _example("1.0"),
    "reference.amplitude_deg": _example("{ {free_hinge} = 10.0 }", "free_hinge"),
    "reference.amplitude_m": _example("{ {free_slide} = 0.01 }", "free_slide"),
    "reference.bias_deg": _example("{ {free_hinge} = 0.0 }", "free_hinge"),
    "reference.bias_m": _example("{ {free_slide} = 0.0 }", "free_slide"),
    "reference.phase_deg": _example("{ {joint} = 0.0 }"),
    "objective.minimize": _example("{ time = 1.0, effort = 1e-5 }"),
    "limits.effort": _example("{ {actuator} = {effort_range} }", "actuator"),
    "limits.range_deg": _example("{ {hinge} = {hinge_range} }", "hinge"),
    "limits.range_m": _example("{ {slide} = {slide_range} }", "slide"),
    "limits.speed_deg_s": _example("{ {hinge} = 900.0 }", "hinge"),
    "limits.speed_m_s": _example("{ {slide} = 1.0 }", "slide"),
    "limits.effort_rate": _example("{ {actuator} = 5000.0 }", "actuator"),
    "limits.power_w": _example("{ {actuator} = 500.0 }", "actuator"),
    "limits.closure_force": _example("{ {closure} = 1000.0 }", "closure"),
    "limits.site": _example("{ {site} = { z = [-inf, inf] } }", "site"),
    "robust.payload_factor": _example("[0.8, 1.2]", "fully_driven"),
    "robust.torque_constant_factor": _example("[0.95, 1.05]", "fully_driven"),
    "robust.viscous_friction": _example("{ {joint} = [0.0, 0.05] }", "fully_driven"),
    "robust.coulomb_friction": _example("{ {joint} = [0.0, 2.0] }", "fully_driven"),
    "motors.{actuator}": _example(_MOTOR, "actuator"),
    "guess.plan": _example('"planned"'),
    "guess.path_deg": _example("{ {free_hinge} = [{free_hinge_home}, {free_hinge_home}] }", "free_hinge"),
    "guess.path_m": _example("{ {free_slide} = [{free_slide_home}, {free_slide_home}] }", "free_slide"),
    "guess.duration_s": _example("1.0"),
    "mesh.tolerance_deg": _example("1e-6"),
    "mesh.breaks": _example("[0.0, 0.5, 1.0]"),
    "tracking.duration_s": _example("2.0"),
    **{f"imperfections.{key}": _example(text, _OF.get(QUANTITIES[key].of, "")) for key, text in _SIZES.items()},
    "imperfections.push_body": _example("{body_name}", "body"),
    "imperfections.push_joint": _example("{joint_name}"),
}
