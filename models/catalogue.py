"""The built-in models and payloads by name. Importing this file is fast."""

import itertools
from collections.abc import Iterable
from pathlib import Path

from linkplan.models.errors import closest, shown

MODELS = {
    "optimus-knee": "the humanoid's knee: a four-bar driven at O within +-100 N.m",
    "optimus-knee-linear": "the same knee as it is really driven: a linear actuator from D to B within +-2000 N, two loops",
    "slider-crank": "crank, rod and slider, driven at the crank within +-2 N.m",
    "andrews-squeezer": "seven bodies, three coupled loops, a spring: the IVP test set's squeezing mechanism",
    "parallel-gripper": "two four-bar fingers geared together, closed by one cable and opened by springs",
    "five-bar": "two motors at the base for two degrees of freedom, one loop, a load on the pin",
    "cart-pole": "a pole on a cart, pushed at the cart: no loop, one force for two degrees of freedom",
    "optimus-knee-source": "the source document's knee, as printed: for checks only",
}
PAYLOADS = ("shank",)


def is_text(source: str) -> bool:
    """Return True if a model's source is MJCF text and not a name or path."""
    return source.lstrip().startswith("<")


def unknown_source(kind: str, source: str, names: Iterable[str]) -> str:
    """Return the refusal of a source that is no built-in name and no existing file; it lists the names, not for a path."""
    names = list(names)
    first = f"unknown {kind} '{shown(source)}'{nearest_source(source, names)}"
    if Path(source).suffix or "/" in source:
        return f"{first}: there is no such file"
    return f"{first}: neither a file nor a built-in name ({', '.join(names)})"


def nearest_source(source: str, names: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the closest built-in name or neighbouring file of a path."""
    path = Path(source)
    lead = source[: len(source) - len(path.name)] if source.endswith(path.name) else ""
    try:
        there = sorted(one.name for one in itertools.islice(path.parent.iterdir(), 1000))
    except (OSError, ValueError):
        there = []
    match = closest(
        path.name, [*([] if lead else names), *(name for name in there if name != path.name and not name.startswith("."))]
    )
    return "" if match is None else f" (did you mean '{lead}{match}'?)"
