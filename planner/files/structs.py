"""The result of a study as a frozen struct: its fields are its JSON, except those of type `Beside`.

A value that follows from the fields is a property of type `InJson`, and its JSON has it after the fields.
"""

import functools
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar, get_origin

import numpy as np
from msgspec import UNSET, Struct, convert
from msgspec.structs import fields

T = TypeVar("T")

if TYPE_CHECKING:
    Beside = Annotated[T, "not in the JSON"]
    Number = float
else:

    class Number(float):
        """The type of a field whose number may not be finite: JSON has null for it, which is read as NaN."""

    class Beside(Generic[T]):
        """The type of a field that figures need and the JSON does not have: `Beside[np.ndarray]`."""


class InJson(property):
    """A property of a struct that its JSON has, too."""


NOT_READ: Any = None
"""The default of a field of type `Beside`: its value in a struct that is read from JSON."""


def json_values(struct: Struct) -> dict[str, Any]:
    """Return the values of a struct's JSON by key."""
    values = ((key, getattr(struct, name), omitted) for name, key, omitted in _json_fields(type(struct)))
    return {key: value for key, value, omitted in values if value is not UNSET and value is not omitted}


@functools.cache
def _json_fields(kind: type[Struct]) -> tuple[tuple[str, str, Any], ...]:
    """Return the attribute, the key and the omitted value of the fields and properties in the JSON."""
    omits = kind.__struct_config__.omit_defaults
    own = [(f.name, f.encode_name, f.default if omits else UNSET) for f in fields(kind) if get_origin(f.type) is not Beside]
    return (*own, *((name, name, UNSET) for name, value in vars(kind).items() if isinstance(value, InJson)))


def read_value(kind: type, value: object) -> object:
    """Return an array or a `Number` from its JSON, with NaN for null: msgspec's hook for reading a struct."""
    return np.array(value, dtype=float) if kind is np.ndarray else kind("nan" if value is None else convert(value, float))
