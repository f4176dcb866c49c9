"""Units of joints and motors in tables for programs: SI, angles in radians."""

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.tree.joints import Joint


def units_of(one: Joint | Actuator) -> tuple[str, str]:
    """Return the units of position and effort of a joint or motor."""
    turns = one.kind == "hinge" if isinstance(one, Joint) else one.unit == "N.m"
    return ("rad", "N.m") if turns else ("m", "N")
