"""Values of joints in a problem file: a table of joint = value under a key that carries the unit."""

from typing import Any

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.keys.section import Section


def joint_values(section: Section, key: str, table_name: str, mechanism: Mechanism) -> dict[int, Any]:
    """Return {joint index: value} of `key`_deg and `key`_m (before any _s), units checked against the joints.

    Raises:
        ProblemError: for an unknown joint, or a joint of the other kind.
    """
    found = {}
    stem, rate = (key[: -len("_s")], "_s") if key.endswith("_s") else (key, "")
    for unit, kind, other in (("deg", "hinge", "m"), ("m", "slide", "deg")):
        name = f"{stem}_{unit}{rate}"
        for joint, value in getattr(section, name).items():
            index = mechanism.joint_index(joint, ProblemError)
            if mechanism.joints[index].kind != kind:
                raise ProblemError(
                    f"joint '{joint}' is a {mechanism.joints[index].kind}; use {table_name}.{stem}_{other}{rate}, not {name}"
                )
            found[index] = value
    return found
