"""Values of joints in a problem file: a table of joint = value under a key that carries the unit."""

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism

# Positions further than so many turns away are a typing error: loops are followed there turn by turn, for minutes.
MOST_TURNS = 100
_NO_NUMBER = 1e300


def joint_values(section: dict, key: str, table_name: str, mechanism: Mechanism) -> dict[int, object]:
    """Return {joint index: raw value} of `key`_deg and `key`_m (before any _s), units checked against the joints.

    Raises:
        ProblemError: for a joint that is none or of the other kind, and an angle of more than MOST_TURNS turns.
    """
    found: dict[int, object] = {}
    stem, rate = (key[: -len("_s")], "_s") if key.endswith("_s") else (key, "")
    for unit, kind, other in (("deg", "hinge", "m"), ("m", "slide", "deg")):
        name = f"{stem}_{unit}{rate}"
        table = section.get(name, {})
        if not isinstance(table, dict):
            raise ProblemError(f"{table_name}.{name} is a table of joint = value, got {table!r}")
        for joint, value in table.items():
            index = mechanism.joint_index(joint, ProblemError)
            if mechanism.joints[index].kind != kind:
                raise ProblemError(
                    f"joint '{joint}' is a {mechanism.joints[index].kind}; use {table_name}.{stem}_{other}{rate}, not {name}"
                )
            # What is no number of radians either is refused as such, by `number`.
            too_far = isinstance(value, int | float) and 360 * MOST_TURNS < abs(value) < _NO_NUMBER
            if kind == "hinge" and not rate and too_far:
                raise ProblemError(
                    f"{table_name}.{name} of joint {joint} is within {MOST_TURNS} turns either way ({360 * MOST_TURNS} deg),"
                    f" got {value:g}"
                )
            found[index] = value
    return found
