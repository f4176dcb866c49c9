"""How much an MJCF text asks for, before MuJoCo makes it: bodies and elements that are repeated, images, height fields.

Read as one row of tokens, which takes any text in one pass: MuJoCo's own reader stands behind it and says what is no XML.
"""

import html
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

# What a text may make: bodies (a flex's points among them), other elements, and what images and height fields take.
MOST_BODIES, MOST_SITES, MOST_ELEMENTS, MOST_ROOM_BYTES = 5000, 10_000, 50_000, 1.2e9
# Bytes that MuJoCo's compiler took at its peak for a channel of a pixel and for a number of a height field, measured.
_CHANNEL_BYTES, _HEIGHT_BYTES = 2.0, 22.0
_TOKEN = re.compile(rb"""<(/?)([A-Za-z_][\w.-]*)|(?<!\w)([A-Za-z_]\w*)\s*=\s*("[^"]*"|'[^']*')|(/?)>""")
# What is no element, to its end or to the text's: comments, character data, instructions.
_ASIDE = re.compile(rb"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)", re.DOTALL)
# MuJoCo's reader takes no more elements within each other than 500.
_DEEPEST = 1000
# A cube's texture has six sides, each as wide as it is high.
_SIDES, _CHANNELS = 6, 3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Element:
    """An opening tag of a text: its name, its attributes as they read, how often it is made."""

    name: str
    attributes: dict[str, str]
    times: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ModelSize:
    """How many bodies, sites and other elements are made, what pictures take; how often models are attached."""

    bodies: float = 0.0
    sites: float = 0.0
    elements: float = 0.0
    room_bytes: float = 0.0
    attached: float = 0.0


def elements_of(content: bytes) -> Iterator[Element]:
    """Yield the elements of an MJCF text in order, each with how often the `replicate`s around it make it."""
    around: list[tuple[str, float]] = []
    name, attributes = "", {}
    for token in _TOKEN.finditer(_ASIDE.sub(b"", content)):
        closing, opened, attribute, value, ends = token.groups()
        if opened is not None and closing:
            if around and around[-1][0] == _text(opened):  # another one is an error, which MuJoCo's reader finds
                around.pop()
            name = ""
        elif opened is not None:
            name, attributes = _text(opened), {}
        elif attribute is not None:
            attributes[_text(attribute)] = html.unescape(_text(value[1:-1]))
        elif name:
            times = around[-1][1] if around else 1.0
            yield Element(name=name, attributes=attributes, times=times)
            if not ends and len(around) < _DEEPEST:
                inner = max(1.0, numbers_in(attributes.get("count", "1"))) if name == "replicate" else 1.0
                around.append((name, times * inner))
            name = ""


def size_of(elements: list[Element]) -> ModelSize:
    """Return what the elements of a text make; what it includes or attaches not counted."""
    bodies = sites = elements_made = room = attached = 0.0
    for element in elements:
        given = element.attributes
        if element.name == "body":
            bodies += element.times
        elif element.name == "flexcomp":
            bodies += element.times * max(1.0, numbers_in(given.get("count", "1")))
        elif element.name == "attach":
            attached += element.times
        elif element.name == "site":
            sites += element.times
        elif element.times > 1:
            elements_made += element.times
        if element.name == "hfield":
            room += numbers_in(given.get("nrow", "0")) * numbers_in(given.get("ncol", "0")) * _HEIGHT_BYTES
        elif element.name == "texture":
            width, height = (numbers_in(given.get(side, "0")) for side in ("width", "height"))
            flat = given.get("type", "cube") == "2d"
            room += image_bytes(width, height if flat else width * _SIDES)
    return ModelSize(bodies=bodies, sites=sites, elements=elements_made, room_bytes=room, attached=attached)


def image_bytes(width: float, height: float) -> float:
    """Return what a picture takes at most while it is read."""
    return width * height * _CHANNELS * _CHANNEL_BYTES


def numbers_in(value: str) -> float:
    """Return the product of an attribute's numbers, infinite where one cannot be told; signs and fractions are dropped."""
    made = 1.0
    for word in value.split():
        try:
            number = float.fromhex(word) if "x" in word.lower() else float(word)
        except (ValueError, OverflowError):
            number = math.inf
        made *= math.inf if math.isnan(number) else abs(number)
    return made


def _text(content: bytes) -> str:
    return content.decode("utf-8", "surrogateescape")
