"""A mechanism in the coordinates of its output joints."""

from collections.abc import Sequence

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.build import mechanism_from_tables


def with_outputs(mechanism: Mechanism, names: Sequence[str]) -> Mechanism:
    """Return a mechanism at the same home with output joints among its independent coordinates.

    Raises:
        ModelError: for an unknown joint, or joints that cannot be coordinates at home, for example at a dead centre.
    """
    if not names or len(set(names)) < len(names):
        raise ProblemError(f"output joints must be one or more different joints, got {', '.join(names) or 'none'}")
    for name in names:
        mechanism.joint_index(name, ProblemError)
    if {joint.name for joint in mechanism.independent_joints} >= set(names):
        return mechanism
    table = dict(mechanism.source) | {"independent": list(names)}
    for unit in ("deg", "m"):
        at = {
            joint.name: joint.shown(position)
            for joint, position in zip(mechanism.joints, mechanism.home.tolist(), strict=True)
            if joint.unit == unit and joint.chart is None
        }
        table |= {f"home_{unit}": at} if at else {}
    return mechanism_from_tables({"mechanism": table})
