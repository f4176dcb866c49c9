"""The YAML files beside a URDF that close its loops: of example-parallel-robots, and of the SolidWorks exporter sw2robot."""

from pathlib import Path
from typing import TypeVar

import msgspec

from linkplan.models.errors import ModelError
from linkplan.models.extras import load_extra
from linkplan.models.reading import read_file

_MOST_YAML_BYTES = 1_000_000
Table = TypeVar("Table", bound=msgspec.Struct)


class Beside(msgspec.Struct, frozen=True):
    """The YAML file of example-parallel-robots; other keys are ignored."""

    closed_loop: list[tuple[str, str]] = []
    type: list[str] = []
    name_mot: list[str] = []
    joint_name: list[str] = []
    joint_type: list[str] = []


class CutHinge(msgspec.Struct, frozen=True):
    """A hinge that was cut: a point [m] on its axis and the axis (3,), in the root link's frame at zero positions."""

    link_a: str
    link_b: str
    point: tuple[float, float, float]
    axis: tuple[float, float, float]


class LoopClosures(msgspec.Struct, frozen=True):
    """The file loop_closures.yaml of sw2robot: cut hinges, and the joints that are driven; other keys are ignored."""

    closures: list[CutHinge]
    independent: list[str] = []


def beside(path: Path) -> Beside | None:
    """Return the closures and motors of the YAML file with a URDF's name, or of the only one beside the only URDF.

    Raises:
        ModelError: for a file with one of its keys that has not its form.
    """
    place = path.with_suffix(".yaml")
    others = list(path.parent.glob("*.yaml"))
    if not place.is_file() and len(others) == 1 and len(list(path.parent.glob("*.urdf"))) == 1:
        place = others[0]
    asked = _table(place, Beside, {"closed_loop", "name_mot"})
    if asked is None:
        return None
    for names, kinds in (("closed_loop", "type"), ("joint_name", "joint_type")):
        count, of = len(getattr(asked, names)), len(getattr(asked, kinds))
        if of != count and (of or kinds == "joint_type"):
            raise ModelError(f"'{place}' has {count} entries in {names} and {of} in {kinds}; they belong together")
    return asked


def loop_closures(path: Path) -> LoopClosures | None:
    """Return the cut hinges of the file loop_closures.yaml in a URDF's folder, in the folder above or in its config.

    Raises:
        ModelError: for a file with closures that has not its form.
    """
    folders = (path.parent, path.parent.parent, path.parent.parent / "config")
    place = next((one for folder in folders if (one := folder / "loop_closures.yaml").is_file()), None)
    return None if place is None else _table(place, LoopClosures, {"closures"})


def _table(place: Path, kind: type[Table], keys: set[str]) -> Table | None:
    """Return a YAML file as a table; None if it is not there or has none of the keys."""
    if not place.is_file():
        return None
    text = read_file(place, f"'{place}'", _MOST_YAML_BYTES, ModelError).decode("utf-8", "replace")
    yaml = load_extra("yaml", f"the closures in '{place}'")
    try:
        found = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ModelError(f"'{place}' is not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(found, dict) or not found.keys() & keys:
        return None
    try:
        return msgspec.convert(found, kind)
    except msgspec.ValidationError as error:
        raise ModelError(f"'{place}' is not what closes a URDF's loops: {error}") from error
