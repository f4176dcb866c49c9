"""What an option takes, by the annotation of its parameter: its name in help, its values, and the words that complete it."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from linkplan.api import names
from linkplan.cli import option_values as values


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of option: how its text is read, and what a shell completes.

    `text` is its help where the parameter's own sentence is about Python. A repeated option makes a list, a table one entry
    for each name. `words`, files that match `patterns` and, if `folders`, folders complete it.
    """

    metavar: str
    parse: Callable[[str], object] = str
    text: str = ""
    is_repeated: bool = False
    is_table: bool = False
    words: tuple[str, ...] = ()
    patterns: tuple[str, ...] = ()
    folders: bool = False


_MODEL_FILES = ("*.xml", "*.mjcf", "*.toml")
_PLAN_TEXT = "a saved plan's folder, a built-in problem or a TOML file"
_SUBJECT = Kind(
    metavar="MODEL-or-PROBLEM",
    text="a built-in model or problem, or an MJCF, URDF or TOML file",
    words=(*names.MODELS, *names.PROBLEMS),
    patterns=_MODEL_FILES,
    folders=True,
)
_EXPORTED = Kind(
    metavar="PLAN-or-MODEL",
    text=f"{_PLAN_TEXT}; for c also a built-in model or an MJCF file",
    words=(*names.PROBLEMS, *names.MODELS),
    patterns=_MODEL_FILES,
    folders=True,
)
_PROBLEM = Kind(
    metavar="PROBLEM",
    text="a built-in problem or a TOML file; its paths (model, guess.plan) are relative to its folder or the working folder",
    words=names.PROBLEMS,
    patterns=("*.toml",),
    folders=True,
)
_PLAN = Kind(metavar="PLAN", text=_PLAN_TEXT, words=names.PROBLEMS, patterns=("*.toml",), folders=True)
_TRACKER = "pd, pd+ff, lqr, lqi, gs-pd+ff, ct or mpc"
# The kinds by the annotation of a parameter, without " | None".
KINDS = {
    "int": Kind(metavar="N", parse=int),
    "float": Kind(metavar="X", parse=float),
    "str": Kind(metavar="NAME"),
    "bool": Kind(metavar=""),
    "Subject": _SUBJECT,
    "PlanLike": _PLAN,
    "AnyPlan": _PLAN,
    "PlanLike | Subject": _EXPORTED,
    "Subject | PhasedProblem": _SUBJECT,
    "ProblemLike": _PROBLEM,
    "AnyProblem": _PROBLEM,
    "str | Path | Source": Kind(
        metavar="MODEL",
        text="a built-in model, or an MJCF or URDF file",
        words=(*names.MODELS, *names.PROBLEMS),
        patterns=_MODEL_FILES,
        folders=True,
    ),
    "str | Path | Mapping": Kind(
        metavar="BATCH",
        text="a TOML file: problem, set, and [[case]] tables or a [sweep] table",
        patterns=("*.toml",),
        folders=True,
    ),
    "str | Path | Sequence[Mapping]": Kind(
        metavar="FILE",
        text="a TOML file with [[motor]] tables, or a CSV file with one motor per row: name, peak_effort, rms_effort, ...",
        patterns=("*",),
    ),
    "Result | Plan | str | Path": Kind(
        metavar="DIR",
        text="a folder by plan, check, compare, experiment, decompose, bode, tune, batch, size or demo",
        folders=True,
    ),
    "TrackerLike": Kind(metavar="TRACKER", text=f"{_TRACKER}; your own as module:object", words=names.TRACKERS),
    "Sequence[TrackerLike]": Kind(
        metavar="TRACKERS",
        parse=values.trackers,
        text="names separated by commas, as for track; or all",
        words=(*names.TRACKERS, "all"),
    ),
    "TrackerName": Kind(metavar="TRACKER", text=_TRACKER, words=names.TRACKERS),
    "CLaw": Kind(
        metavar="LAW-IN-C", text=f"for c: the law of a plan, one of {', '.join(names.C_TRACKERS)}", words=names.C_TRACKERS
    ),
    "Law": Kind(metavar="LAW", text=f"{', '.join(names.LINEAR[:-1])} or {names.LINEAR[-1]}", words=names.LINEAR),
    "Design": Kind(metavar="DESIGN", words=names.DESIGNS),
    "FileKind": Kind(metavar="KIND", words=names.FILE_KINDS),
    "ExportFormat": Kind(
        metavar="FORMAT",
        text=f"one of {', '.join(f'{name} ({what})' for name, what in (names.FORMATS | names.FOLDER_FORMATS).items())}",
        words=(*names.FORMATS, *names.FOLDER_FORMATS),
    ),
    "Shell": Kind(metavar="SHELL", words=names.SHELLS),
    "Sequence[str]": Kind(metavar="A,B", parse=values.names),
    "Gains": Kind(metavar="K", parse=values.numbers),
    "Frequencies": Kind(
        metavar="F",
        parse=values.frequencies,
        text=(
            "frequencies to measure [Hz], F,F,... or LOW:HIGH:N for N with equal ratios (default: 20 about crossover or"
            " resonances)"
        ),
    ),
    "Poses": Kind(metavar="JOINT=VALUE", parse=values.pose, is_repeated=True),
    "Mapping[str, float]": Kind(metavar="JOINT=VALUE", parse=values.joint_value, is_table=True),
    "Mapping[str, Sequence[float]]": Kind(metavar="JOINT=LOW:HIGH", parse=values.joint_range, is_table=True),
    "ByParameter": Kind(metavar="NAME=VALUE", parse=values.tolerance, is_table=True),
    "SiteForces": Kind(metavar="SITE=X,Y,Z", parse=values.site_force, is_table=True),
    "tuple[int, int]": Kind(metavar="WxH", parse=values.size),
    "str | Path": Kind(metavar="FILE", patterns=("*",)),
}
# Numbers are called by the unit at the end of the parameter's name.
_UNITS = {"s": "SECONDS", "hz": "HZ", "deg": "DEG", "m": "M"}
# The options that say how the first argument is read.
SOURCES = {
    "Subject": ("set", *names.SELECTION),
    "Subject | PhasedProblem": ("set", *names.SELECTION),
    "PlanLike": ("set", "anyway"),
    "AnyPlan": ("set", "anyway"),
    "PlanLike | Subject": ("set", "anyway", *names.SELECTION),
    "ProblemLike": ("set",),
    "AnyProblem": ("set",),
    "str | Path | Source": ("set",),
}


def kind_of(name: str, annotation: str) -> Kind:
    """Return the kind of a parameter."""
    if name == "folder":
        return Kind(metavar="DIR", folders=True)
    kind = KINDS[annotation]
    unit = re.search(r"_(s|hz|deg|m)$", name)
    return kind if annotation != "float" or unit is None else Kind(metavar=_UNITS[unit[1]], parse=float)
