"""The elements of a problem file's section: keys with their meanings, units and defaults."""

from typing import Any

from msgspec import Meta, Struct

# The value of a key that is left out and has no single default. No type admits it, so no file can contain it.
ABSENT: Any = None


def key(meaning: str, unit: str = "", default: str = "", example: str = "", needs: str = "") -> Meta:
    """Return a key's description.

    Args:
        meaning: a phrase.
        unit: of its value.
        default: a phrase for its default, if that is no single value.
        example: such a key's value as TOML, with placeholders in braces for a mechanism's names: {hinge}, {actuator}, ...
        needs: what a mechanism must have for the key, in addition to the placeholders: "closure", "fully_driven".
    """
    sentence = f"{meaning[0].upper()}{meaning[1:]}" + (f" [{unit}]" if unit else "") + "."
    shown = {"x-unit": unit} if unit else {}
    return Meta(
        description=f"{sentence} Default: {default}." if default else sentence,
        extra={"meaning": meaning, "unit": unit, "default": default, "example": example, "needs": needs},
        extra_json_schema=shown,
    )


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """A table of known keys."""
