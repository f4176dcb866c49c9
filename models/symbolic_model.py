"""A compiled model some of whose numbers are CasADi expressions, read field by field like `mujoco.MjModel`.

The builders of the tree, its closures and transmissions read the numbers of a model by `number` and `column`. These return
expressions for the entries that a `SymbolicModel` replaces, and constants for all others, which CasADi folds.
"""

from collections.abc import Mapping
from typing import Any

import casadi as ca
import mujoco
import numpy as np

# A field of `mujoco.MjModel` with the index of one of its numbers: ("body_mass", (3,)), ("body_ipos", (3, 0)).
Entry = tuple[str, tuple[int, ...]]


class SymbolicModel:
    """A compiled model with expressions in place of some of its numbers.

    A row that has an expression is an `ca.SX` column, a number that is one an `ca.SX` scalar. Every other row and field is
    that of `numeric`, the compiled model. A field with expressions has no array: an operation that would lose them fails.

    Args:
        numeric: the compiled model.
        entries: an expression for each number that is replaced.
    """

    def __init__(self, numeric: mujoco.MjModel, entries: Mapping[Entry, ca.SX]) -> None:
        self.numeric = numeric
        rows: dict[str, dict[int, dict[tuple[int, ...], ca.SX]]] = {}
        for (field, (row, *place)), value in entries.items():
            rows.setdefault(field, {}).setdefault(row, {})[tuple(place)] = value
        self._fields = {field: _Field(getattr(numeric, field), of) for field, of in rows.items()}

    def __getattr__(self, name: str) -> Any:
        fields = self.__dict__.get("_fields", {})
        return fields[name] if name in fields else getattr(self.numeric, name)


class _Field:
    """An array of a compiled model some of whose rows have expressions."""

    def __init__(self, numbers: np.ndarray, rows: Mapping[int, Mapping[tuple[int, ...], ca.SX]]) -> None:
        self._numbers, self._rows = numbers, {}
        for row, values in rows.items():
            found = ca.SX(ca.DM(np.atleast_1d(numbers[row])))
            for place, value in values.items():
                found[place or (0,)] = value
            self._rows[row] = found

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, index: Any) -> Any:
        row, *place = index if isinstance(index, tuple) else (index,)
        if not isinstance(row, int | np.integer):
            raise TypeError(f"rows with expressions are read one by one, got {row!r}")
        if int(row) not in self._rows:
            return self._numbers[index]
        found = self._rows[int(row)]
        return found[place[0]] if place else found


def numeric(model: Any) -> mujoco.MjModel:
    """Return the compiled model itself, in which every entry is a number."""
    return model.numeric if isinstance(model, SymbolicModel) else model


def number(value: Any) -> Any:
    """Return one number of a model as a float, or its expression."""
    return value if isinstance(value, ca.SX) else float(value)


def column(values: Any) -> ca.SX | ca.DM:
    """Return a row of a model as a constant column, or as the column of expressions that it is."""
    return values if isinstance(values, ca.SX) else ca.DM(values)


def is_zero(value: Any) -> bool:
    """Return whether a number of a model is zero at every value of the parameters."""
    return bool(value.is_zero()) if isinstance(value, ca.SX) else not value


def unit_of(values: Any) -> Any:
    """Return the unit vector of a row of a model, an array or a column of expressions."""
    return values / ca.norm_2(values) if isinstance(values, ca.SX) else values / np.linalg.norm(values)


def axis_of(model: Any, joint: int) -> ca.SX | ca.DM:
    """Return a joint's axis in its body's frame, of which the compiler has made a unit vector."""
    axis = model.jnt_axis[joint]
    return unit_of(axis) if isinstance(axis, ca.SX) else ca.DM(axis)
