"""Sections of a file: structs whose every key is declared once, with its kind, unit, default and meaning.

    range_deg: Ranges = by_joint("hinges' ranges", "deg", "the model's own")

A key of hinges in degrees (`by_joint`) also declares its twin for slides in metres, range_m.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Self

from msgspec import NODEFAULT, Meta, Struct, structs

from linkplan.planner.problem.keys import kinds

# The value of an omitted key without a single default. It has no legal type, so no file can contain it.
ABSENT: Any = None
# Words for a key of hinges, and for its twin of slides; likewise for kinds.
_WORDS = (("hinge", "slide"), ("angle", "position"))
_KINDS = ((kinds.Angles, kinds.Numbers), (kinds.HomeAngles, kinds.HomeLengths))


@dataclass(frozen=True, eq=False, slots=True)
class _Key:
    """The description of a key, which stands in the body of a section where a default would stand.

    Args:
        meaning: a phrase.
        unit: of its value.
        otherwise: a phrase for its default, if that is no single value.
        default: its value if it is left out.
        twin: phrases that differ for slides, as pairs; None without a twin.
        kind: of its values, if the section does not say; `twin_kind` likewise.
    """

    meaning: str
    unit: str = ""
    otherwise: str = ""
    default: Any = ABSENT
    twin: tuple[tuple[str, str], ...] | None = None
    kind: Any = None
    twin_kind: Any = None

    def of(self, kind: Any) -> Any:
        """Return the kind of its values with the description."""
        sentence = f"{self.meaning[0].upper()}{self.meaning[1:]}" + (f" [{self.unit}]" if self.unit else "") + "."
        single = self.default if isinstance(self.default, int | float | str) else ""
        default = self.otherwise or (f"{single:g}" if isinstance(single, float) else str(single))
        described = f"{sentence} Default: {default}." if default else sentence
        words = {name: getattr(self, name) for name in ("meaning", "unit", "otherwise")}
        shown = {"x-unit": self.unit} if self.unit else {}
        return Annotated[self.kind or kind, Meta(description=described, extra=words, extra_json_schema=shown)]

    def of_slides(self) -> "_Key":
        """Return its twin."""
        words = {name: getattr(self, name) for name in ("meaning", "otherwise")}
        for hinges, slides in (*(self.twin or ()), *_WORDS):
            words = {name: text.replace(hinges, slides) for name, text in words.items()}
        return replace(self, unit=self.unit.replace("deg", "m"), kind=self.twin_kind, **words)


key: Any = _Key
required: Any = functools.partial(_Key, default=NODEFAULT)
by_name: Any = functools.partial(_Key, default={})
by_joint: Any = functools.partial(_Key, default={}, twin=())


class _Declared(type(Struct)):
    """Creates the struct of a section whose defaults are descriptions of keys."""

    def __new__(cls, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> type:
        asked = namespace.get("__annotations__") or namespace.get("__annotate_func__", lambda _: {})(1)
        found: list[tuple[str, Any, Any]] = []
        for field, kind in asked.items():
            said = namespace.pop(field, NODEFAULT)
            found.append((field, kind, said))
            if isinstance(said, _Key) and said.twin is not None:
                slides = next((other for one, other in _KINDS if one is kind), kind)
                found.append((field.replace("_deg", "_m"), slides, said.of_slides()))
        plain = [
            (one, said.of(kind), said.default) if isinstance(said, _Key) else (one, kind, said) for one, kind, said in found
        ]
        namespace |= {field: default for field, _, default in plain if default is not NODEFAULT}
        namespace["__annotations__"] = {field: kind for field, kind, _ in plain}
        return super().__new__(cls, name, bases, namespace, **options)


class Section(Struct, metaclass=_Declared, frozen=True, forbid_unknown_fields=True):
    """A table of known keys."""

    def replace(self, **changes: object) -> Self:
        """Return the section with new values, checked as its first ones."""
        return structs.replace(self, **changes)

    def to_dict(self) -> dict[str, Any]:
        """Return the section as a table of a file. A key with its default value is left out."""
        values = ((name, getattr(self, name), default) for name, default in _defaults(type(self)))
        return {name: _table(value) for name, value, default in values if value != default}


@functools.cache
def _defaults(kind: type[Section]) -> tuple[tuple[str, Any], ...]:
    """Return the keys of a section with their defaults."""
    made = ((one, one.default_factory) for one in structs.fields(kind))
    return tuple((one.name, one.default if make is NODEFAULT else make()) for one, make in made)


def _table(value: Any) -> Any:
    """Return a copy of a decoded value in the types of a file."""
    if isinstance(value, Section):
        return value.to_dict()
    if isinstance(value, Mapping):
        return {name: _table(item) for name, item in value.items()}
    return [_table(item) for item in value] if isinstance(value, list | tuple) else value


@dataclass(frozen=True, eq=False, slots=True)
class KeyOf:
    """The key of a dataclass field. The field has values in SI by index; `section_of` derives the section from such fields.

    Args:
        name: of the key; for values by joint in degrees, the key of hinges, which also declares that of slides.
        by: what the key's table has values for: actuator, joint, closure, site, body; "" for a key with one value.
        kind: of its value in a file.
        meaning: a phrase.
        unit: of its values.
        otherwise: a phrase for an empty table.
    """

    name: str
    by: str
    kind: Any
    meaning: str
    unit: str = ""
    otherwise: str = "none"


def keys_of(declared: type) -> dict[str, KeyOf]:
    """Return the keys that the fields of a dataclass declare, by the fields' names."""
    return {one.name: one.type.__metadata__[0] for one in fields(declared)}


def section_of(declared: type, name: str, doc: str) -> type[Section]:
    """Return the section of the keys that a dataclass declares."""
    namespace: dict[str, Any] = {"__doc__": doc, "__module__": declared.__module__, "__annotations__": {}}
    for field, said in zip(fields(declared), keys_of(declared).values(), strict=True):
        otherwise, default = (said.otherwise, {}) if said.by else ("", field.default)
        namespace["__annotations__"][said.name] = said.kind
        namespace[said.name] = key(said.meaning, said.unit, otherwise, default, () if said.by == "joint" else None)
    made: Any = _Declared  # the type checker expects a metaclass to return an instance of the calling class
    return made(name, (Section,), namespace, frozen=True)


# The bound of quantities without a natural one, in their own units.
_MAX_QUANTITY = 1e9
# The legal forms of a value.
FORMS = "a number, a range [low, high], { uniform = [low, high] } or { normal = [mean, std] }"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A quantity that can be wrong: its unit, its range, and its owner.

    `of` is "" for the whole machine, "hinge" or "slide" (independent joints of that kind), "joint" (any), "actuator",
    "body" or "parameter".
    """

    unit: str
    low: float
    high: float
    of: str

    @property
    def kind(self) -> Any:
        """The type of its value: `FORMS`, or a table of these by name."""
        value = {"type": "number", "minimum": self.low, "maximum": self.high}
        deviation = {"type": "number", "minimum": 0, "maximum": 1e15}
        uniform = {"type": "array", "items": value, "minItems": 2, "maxItems": 2}
        normal = {"type": "array", "prefixItems": [value, deviation], "minItems": 2, "maxItems": 2}
        laws = {"uniform": uniform, "normal": normal}
        law = {"type": "object", "properties": laws, "additionalProperties": False, "minProperties": 1, "maxProperties": 1}
        forms = [value, uniform, law]
        if self.of:
            names = {"not": {"enum": list(laws)}}
            forms.append({"type": "object", "additionalProperties": {"anyOf": [*forms]}, "propertyNames": names})
        said = f"{FORMS}, or a table of these by name" if self.of else FORMS
        return Annotated[Any, Meta(extra={"said": said, "quantity": self}, extra_json_schema={"anyOf": forms})]


def quantity(
    meaning: str,
    unit: str,
    low: float = -_MAX_QUANTITY,
    high: float = _MAX_QUANTITY,
    of: str = "",
    otherwise: str = "nominal",
    twin: bool = False,
) -> Any:
    """Return the description of a quantity's key; with `twin` that of hinges, which declares the key of slides too."""
    kind = Quantity(unit or "1", low, high, of).kind
    if not twin:
        return key(meaning, unit, otherwise, kind=kind)
    of_slides = Quantity(unit.replace("deg", "m"), -_MAX_QUANTITY if low < 0 else 0.0, _MAX_QUANTITY, "slide").kind
    return key(meaning, unit, otherwise, twin=(), kind=kind, twin_kind=of_slides)


def name_of(meaning: str) -> Any:
    """Return the description of a key whose value is a name."""
    return key(meaning, "", "none", kind=Annotated[str, Meta(min_length=1, extra={"said": "a name"})])
