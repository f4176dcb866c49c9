"""A mechanism as a piece of HTML for notebooks: its degrees of freedom, joints, actuators and closures."""

from collections.abc import Sequence
from html import escape

import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.errors import counted
from linkplan.models.tree.joints import Joint


def mechanism_html(
    name: str,
    dof: int,
    joints: Sequence[Joint],
    independent: np.ndarray,
    actuators: Sequence[Actuator],
    closures: Sequence[str],
) -> str:
    """Return the HTML of a mechanism's parts; names are escaped."""
    kinds = ["independent" if k in independent else "dependent" for k in range(len(joints))]
    rows = [
        [joint.name, f"{joint.kind}, {kind}", _between(joint.shown(joint.lower), joint.shown(joint.upper), joint.unit)]
        for joint, kind in zip(joints, kinds, strict=True)
    ]
    rows += [[one.name, "actuator", _between(one.lower, one.upper, one.unit)] for one in actuators]
    rows += [[closure, "closure", ""] for closure in closures]
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    caption = f"<caption>Mechanism {escape(name)}: {counted(dof, 'degree')} of freedom</caption>"
    head = "<thead><tr><th>part</th><th>kind</th><th>range or limit</th></tr></thead>"
    return f"<table>{caption}{head}<tbody>{body}</tbody></table>"


def _between(low: float, high: float, unit: str) -> str:
    return f"{low:.5g} to {high:.5g} {unit}" if np.isfinite([low, high]).any() else "none"
