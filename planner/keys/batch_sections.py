"""The sections of a batch file: a problem and its variations."""

from typing import Annotated, Any

from msgspec import Meta

from linkplan.planner.keys.kinds import Settings
from linkplan.planner.keys.section import Section, key

# Each case has a folder with its name, next to the JSON records of results: so names have no separators, wildcards or
# unprintable characters, and do not end in .json.
_FOLDER_NAME = Meta(
    pattern=r"""^(?!.*\.[jJ][sS][oO][nN]$)[^./\\:*?"<>|\x00-\x1f\x7f][^/\\:*?"<>|\x00-\x1f\x7f]*$""",
    max_length=99,
    extra={"said": "a word that can name a folder, without .json at its end"},
)
_PROBLEM = Meta(min_length=1, extra={"said": "a built-in name or a TOML file"})
_CASES = Meta(min_length=1, extra={"said": "a list of tables ([[case]])"})
_SWEEP = Meta(min_length=1, extra={"said": "a table of key = list of values", "of": "key = list of values"})


class CaseSection(Section, frozen=True):
    """One problem of a batch."""

    name: Annotated[str, _FOLDER_NAME, key("names its folder", default="its number")] = ""
    set: Annotated[Settings, key('settings on the problem, "section.key=value"', default="none")] = []


class BatchFile(Section, frozen=True):
    """Many variations of one problem: a list of cases, or every combination of a sweep."""

    problem: Annotated[str, _PROBLEM, key("the problem that is varied: a built-in name or a TOML file")]
    set: Annotated[Settings, key("settings for all cases", default="none")] = []
    case: Annotated[list[CaseSection], _CASES, key("the cases", default="those of the sweep")] = []
    sweep: Annotated[dict[str, Any], _SWEEP, key("lists of values by key; every combination is a case", default="none")] = {}
