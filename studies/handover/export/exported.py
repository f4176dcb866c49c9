"""What `export` wrote, a base class of its records."""

from pathlib import Path

from msgspec import Struct

from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.output.result import Shown


class Exported(Shown, Struct, frozen=True, kw_only=True):
    """The record of an export, its JSON; its `path`, and whether the plan passes, are beside it."""

    path: Beside[Path] = NOT_READ
    passed: Beside[bool] = NOT_READ
