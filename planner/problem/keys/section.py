"""Sections of a file: structs whose every key is declared once, with its kind, unit, default and meaning.

    range_deg: Ranges = by_joint("hinges' ranges", "deg", "the model's own")

A key of hinges in degrees (`by_joint`) declares its twin of slides in metres, range_m, too.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Self

from msgspec import NODEFAULT, Meta, Struct, structs

from linkplan.planner.problem.keys import kinds

# The value of a key that is left out and has no single default. No type admits it, so no file can contain it.
ABSENT: Any = None
# Words of a key of hinges, and of its twin of slides; kinds likewise.
_WORDS = (("hinge", "slide"), ("angle", "position"))
_KINDS = ((kinds.Angles, kinds.Numbers), (kinds.HomeAngles, kinds.HomeLengths))


@dataclass(frozen=True, eq=False, slots=True)
class _Key:
    """A key's description, which stands in place of its default in a section.

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
        described = f"{sentence} Default: {self.otherwise}." if self.otherwise else sentence
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
    """Makes a struct of a section whose defaults are descriptions of keys."""

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


def section_of(name: str, doc: str, module: str, keys: Mapping[str, tuple[Any, _Key]]) -> type[Section]:
    """Return a section of keys that are declared elsewhere, each with the kind of its values and its description."""
    namespace: dict[str, Any] = {"__doc__": doc, "__module__": module}
    namespace["__annotations__"] = {one: kind for one, (kind, _) in keys.items()}
    made: Any = _Declared  # the type checker expects a metaclass to return an instance of its caller's
    return made(name, (Section,), namespace | {one: said for one, (_, said) in keys.items()}, frozen=True)
