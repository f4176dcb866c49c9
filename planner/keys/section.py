"""What a section of a problem file is made of: keys with their meanings, units and defaults."""

from typing import Any

from msgspec import Meta, Struct

# The value of a key that is left out and has no single default. No file can say it: no kind of value admits it.
ABSENT: Any = None


def key(meaning: str, unit: str = "", default: str = "") -> Meta:
    """Return what is said of a key: its meaning, its unit, and its default in words where that is no single value."""
    said = f"{meaning[0].upper()}{meaning[1:]}" + (f" [{unit}]" if unit else "") + "."
    shown = {"x-unit": unit} if unit else {}
    return Meta(
        description=f"{said} Default: {default}." if default else said,
        extra={"meaning": meaning, "unit": unit, "default": default},
        extra_json_schema=shown,
    )


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """A table of known keys."""
