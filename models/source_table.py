"""The source of a mechanism as the [mechanism] table of a problem file."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from linkplan.models.payload import Payload
from linkplan.models.selection import Selection
from linkplan.models.tree.joints import Joint


def source_table(
    source: str | Path,
    payload: Payload | None,
    home: Mapping[str, float] | None,
    joints: Sequence[Joint],
    selection: Selection,
    asked: Mapping[str, object],
) -> dict[str, object]:
    """Return the table of a model: its payload, home [rad or m], selection, and the keys in `asked` that are not None."""
    table: dict[str, object] = {"model": str(source)}
    if payload is not None:
        table["payload"] = payload.table()
    for joint in joints:
        if home is not None and joint.name in home:
            table.setdefault(f"home_{joint.unit}", {})[joint.name] = joint.shown(home[joint.name])
    table |= selection.table()
    for key, value in asked.items():
        if value is not None:
            table[key] = list(value) if isinstance(value, list | tuple) else value
    return table
