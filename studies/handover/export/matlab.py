"""A plan as a MATLAB file: its motion by joint and actuator, and a struct of the same shape with the units."""

import io
import re
from collections.abc import Iterable

import scipy.io

from linkplan.studies.handover.export.samples import ExportedSamples


def mat_bytes(samples: ExportedSamples) -> bytes:
    """Return a MATLAB 5 file: time_s (n, 1), and structs position, speed, acceleration, effort, site, body by name.

    `units` has the same structs with a unit for each name, `names` has the names of the model.
    """
    table = samples.table
    content: dict = {"time_s": table.time_s, "plan": samples.plan.problem.name}
    units: dict = {"time_s": "s"}
    names: dict = {}
    for group, rows in table.by_quantity().items():
        if rows:
            fields = _fields(rows)
            content[group] = {fields[name]: values for name, (_, values) in rows.items()}
            units[group] = {fields[name]: unit for name, (unit, _) in rows.items()}
            names[group] = {field: name for name, field in fields.items()}
    file = io.BytesIO()
    scipy.io.savemat(file, content | {"units": units, "names": names}, long_field_names=True, oned_as="column")
    return file.getvalue()


def _fields(names: Iterable[str]) -> dict[str, str]:
    """Return a unique MATLAB field name for each name: letters, digits and _, starting with a letter.

    MATLAB's format keeps 63 characters of a field name; four of them are for a number.
    """
    found: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
        plain = (plain if plain[:1].isalpha() else f"x{plain}")[:59]
        field, number = plain, 1
        while field in found.values():
            number += 1
            field = f"{plain}_{number}"
        found[name] = field
    return found
