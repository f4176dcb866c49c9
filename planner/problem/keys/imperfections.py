"""The section [imperfections]: quantities of simulated machines that can be wrong, each with its range and owner."""

from collections.abc import Mapping
from typing import Any

from msgspec.structs import fields

from linkplan.planner.problem.keys.section import Quantity, Section, name_of, quantity


class ImperfectionsSection(Section, frozen=True):
    """Imperfections of simulated machines, as a value or a distribution for each quantity."""

    period_factor: Any = quantity("ratio of the controller's actual to its nominal period", "", 0.5, 2.0)
    phase_periods: Any = quantity("delay of the first control instant after the motion begins", "control periods", 0.0, 1.0)
    delay_periods: Any = quantity("added to tracking.delay_periods; may be fractional", "control periods", 0.0, 1000.0)
    encoder_resolution_deg: Any = quantity(
        "step to which hinges' positions are rounded", "deg", 0.0, 360.0, "hinge", twin=True
    )
    encoder_offset_deg: Any = quantity("error of hinges' measured positions", "deg", -360.0, 360.0, "hinge", twin=True)
    position_noise_deg: Any = quantity(
        "standard deviation of white noise on hinges' positions", "deg", 0.0, 360.0, "hinge", twin=True
    )
    velocity_noise_deg_s: Any = quantity(
        "standard deviation of white noise on hinges' velocities, if these are measured directly",
        "deg/s",
        0.0,
        of="hinge",
        twin=True,
    )
    velocity_filter_hz: Any = quantity(
        "velocity is the difference of measured positions, filtered by a first-order low-pass of this cutoff",
        "Hz",
        1e-6,
    )
    torque_resolution: Any = quantity("step to which commands are rounded", "N.m or N", 0.0, of="actuator")
    torque_bandwidth_hz: Any = quantity("bandwidth of the drive's first-order lag", "Hz", 1e-6, of="actuator")
    torque_rate: Any = quantity("largest rate of the drive's effort", "N.m/s or N/s", 1e-9, 1e15, of="actuator")
    torque_constant_factor: Any = quantity("ratio of actual to commanded effort", "", 0.01, 100.0, of="actuator")
    viscous_friction: Any = quantity("damping of any joint, added to the model's", "N.m.s/rad or N.s/m", 0.0, of="joint")
    coulomb_friction: Any = quantity("dry friction of any joint", "N.m or N", 0.0, of="joint")
    parameters: Any = quantity(
        "numbers of the model by name, which `check` with `parameters` lists, in place of those in [parameters] that have"
        " a range, sd or tolerance",
        "SI",
        of="parameter",
        otherwise="as in [parameters]",
    )
    payload_mass_factor: Any = quantity(
        "factor on the mass and inertia of the payload, or of all moving bodies if there is none",
        "",
        0.001,
        1000.0,
    )
    payload_com_x_m: Any = quantity("shift of the payload's centre of mass along x of its body", "m")
    payload_com_y_m: Any = quantity("shift along y", "m")
    payload_com_z_m: Any = quantity("shift along z", "m")
    link_length_factor: Any = quantity(
        "scales all points fixed to a link about its joint; the loop is assembled again",
        "",
        0.1,
        10.0,
        of="body",
    )
    push_start_s: Any = quantity("time at which a push begins", "s", 0.0, otherwise="0")
    push_duration_s: Any = quantity("duration of the push", "s", 0.0, otherwise="none")
    push_force_x_n: Any = quantity("force along x of the world on push_body's centre of mass", "N", otherwise="none")
    push_force_y_n: Any = quantity("force along y", "N", otherwise="none")
    push_force_z_n: Any = quantity("force along z", "N", otherwise="none")
    push_effort: Any = quantity("effort on push_joint", "N.m or N", otherwise="none")
    start_error_deg: Any = quantity("hinges' initial distance from the path", "deg", -360.0, 360.0, "hinge", twin=True)
    start_velocity_error_deg_s: Any = quantity("hinges' initial velocity error", "deg/s", of="hinge", twin=True)
    loop_time_constant_s: Any = quantity(
        "time constant of the loop constraint in MuJoCo's solref; at least two simulator steps", "s", 1e-9
    )
    loop_damping_ratio: Any = quantity("damping ratio of the loop constraint", "", 0.001, 1000.0)
    push_body: Any = name_of("the body on which a push's force acts")
    push_joint: Any = name_of("the joint on which a push's effort acts")


_FIELDS = {field.name: field.type.__metadata__[0].extra.get("quantity") for field in fields(ImperfectionsSection)}
QUANTITIES: Mapping[str, Quantity] = {name: quantity for name, quantity in _FIELDS.items() if quantity is not None}
# Keys whose values are names and not distributions.
WORDS = tuple(name for name, quantity in _FIELDS.items() if quantity is None)
