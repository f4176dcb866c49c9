"""The text of a model before MuJoCo reads it: its size, its language, and its XML elements as MuJoCo's reader finds them."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from linkplan.models.catalogue import MODELS, is_text
from linkplan.models.errors import ModelError, shown
from linkplan.models.reading import read_file

# Largest model file; the largest model of MuJoCo Menagerie has some hundred kilobytes.
MAX_MODEL_BYTES = 32_000_000
_COUNT = re.compile(rb"""\b(count|dim|nrow|ncol|nuserdata|njmax|nconmax|nstack)\s*=\s*["']([^"']*)["']""")
_SDF = re.compile(rb"<sdf[\s>]")
_XACRO, _ENTITY, COMMENT = re.compile(rb"<xacro:\w"), re.compile(rb"<!ENTITY\s"), re.compile(rb"<!--.*?-->", re.DOTALL)
_UNITS = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40, "P": 2**50, "E": 2**60}
# Comments and declarations, which have no content; a CDATA section (group 1) may hold their marks.
_WITHOUT_CONTENT = re.compile(r"(<!\[CDATA\[.*?\]\]>)|<!--.*?-->|<\?.*?\?>", re.DOTALL)
# An ampersand that MuJoCo's reader takes literally.
_PLAIN_AMPERSAND = re.compile(r"&(?!(?:lt|gt|amp|quot|apos|#\d+|#x[0-9a-fA-F]+);)")
_FIRST_TAG = re.compile(r"<([^\s!?/>]+)")


def refuse_oversized(content: bytes, what: str) -> None:
    """Refuse an MJCF text that is too long, has a count or size above the limits, or would be read by MuJoCo only in part.

    Args:
        content: the text.
        what: name of the text in messages.

    Raises:
        ModelError: if a limit is exceeded, for zero bytes, XML entities, SDF and xacro (with converters for the last two).
    """
    if len(content) > MAX_MODEL_BYTES:
        raise ModelError(f"{what} has {len(content)} bytes; at most {MAX_MODEL_BYTES} are read")
    if b"\0" in content:
        raise ModelError(f"{what} does not parse: it holds zero bytes; a model is MJCF or URDF text")
    if _SDF.search(content):
        raise ModelError(
            f"{what} is SDF, and models are MJCF or URDF: sdf2mjcf (pip install sdformat-mjcf) converts it; then close its"
            " loops by <connect> elements"
        )
    read = COMMENT.sub(b"", content)
    if _XACRO.search(read):
        raise ModelError(
            f"{what} is xacro, which makes a URDF: xacro (pip install xacro, or ROS) expands it: xacro FILE > robot.urdf"
        )
    if _ENTITY.search(read):
        raise ModelError(
            f"{what} declares an XML entity (<!ENTITY>), which MuJoCo does not replace: write its text in its place"
        )
    for name, value in _COUNT.findall(content):
        # Numbers of 8 bytes each, and 20,000 bodies of a replicate, which take seconds and a gigabyte.
        most = {b"nstack": 1e8}.get(name, 20_000)
        if any(_number(word) > most for word in value.decode("utf-8", "replace").split()):
            text = shown(value.decode("utf-8", "replace"), 40)
            raise ModelError(f'{what} has {name.decode()} = "{text}"; at most {most:g} is read')


def _number(word: str) -> float:
    """Return the number, with an optional unit letter, that a word is; 0 for any other word, which MuJoCo refuses."""
    try:
        return float(word.rstrip("KMGTPEkmgtpe")) * _UNITS.get(word[-1:].upper(), 1)
    except ValueError:
        return 0.0


def urdf_root(source: str | Path) -> ET.Element | None:
    """Return the <robot> element of a URDF that MuJoCo reads (a path or text); None for another model.

    Tags have no prefix: elements of a default namespace, as in Drake's URDFs, are those of MuJoCo.

    Raises:
        ModelError: for XML of which MuJoCo's reader, tinyxml2, reads only a part or more than the XML standard allows.
    """
    text, what = str(source), "URDF text"
    if not is_text(text):
        if text in MODELS:
            return None
        what = f"model '{text}'"
        text = read_file(Path(text), what, MAX_MODEL_BYTES, ModelError).decode("utf-8", "replace")
    return robot_element(text, what)


def robot_element(text: str, what: str) -> ET.Element | None:
    """Return the <robot> element of a text; None for another model. See `urdf_root`."""
    plain = _WITHOUT_CONTENT.sub(lambda found: found[1] or "\n" * found[0].count("\n"), text)
    first = _FIRST_TAG.search(plain)
    is_urdf = first is not None and first[1].lower() == "robot"  # MuJoCo reads <Robot> too
    try:
        root = _elements(_PLAIN_AMPERSAND.sub("&amp;", plain))
    except expat.ExpatError as error:
        if is_urdf or error.code == expat.errors.codes[expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT]:
            raise ModelError(
                f"{what} is not well-formed XML ({error}), and MuJoCo would read a part of it; correct that place"
                " (xmllint FILE shows it)"
            ) from error
        return None
    return root if is_urdf else None


def _elements(text: str) -> ET.Element:
    """Return the root element of a text; what stands before it counts for its line numbers only.

    Names keep no prefix, which need not be bound to a namespace.
    """
    builder, parser = ET.TreeBuilder(), expat.ParserCreate("utf-8")
    parser.buffer_text = True
    parser.StartElementHandler = lambda name, given: builder.start(name.rpartition(":")[2], given)
    parser.EndElementHandler = lambda name: builder.end(name.rpartition(":")[2])
    parser.CharacterDataHandler = builder.data
    start = text.find("<")
    parser.Parse(("\n" * text.count("\n", 0, start) + text[start:]).encode("utf-8", "replace"), True)
    return builder.close()
