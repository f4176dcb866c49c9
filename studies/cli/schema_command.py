"""The command `schema`."""

import argparse
import json
from pathlib import Path

from linkplan.models.errors import ProblemError, choose
from linkplan.planner.files.single_file import write_over
from linkplan.studies.cli.exit_codes import DONE
from linkplan.studies.cli.printing import show


def run_schema(arguments: argparse.Namespace) -> int:
    """Print the JSON Schema of problem files or of batch files, or write it into a file."""
    from linkplan.planner.keys.key_table import FILES, json_schema

    said = json_schema(choose("kind of file", arguments.file, FILES, ProblemError))
    text = json.dumps(said, indent=2)
    if arguments.output is None:
        show(arguments, said, text)
        return DONE
    place = Path(arguments.output)
    if not arguments.output or place.is_dir():
        raise ProblemError(f"-o takes a file, got '{arguments.output}'")
    if place.exists() and not _is_a_schema(place):
        raise ProblemError(f"-o: '{place}' is there and not linkplan's; move it or name another file")
    write_over(place, f"{text}\n".encode())
    if arguments.json:
        show(arguments, said, text)
    return DONE


def _is_a_schema(place: Path) -> bool:
    """Tell if a file is empty or a schema that linkplan wrote, which may be replaced."""
    from linkplan.models.errors import LinkplanError
    from linkplan.models.reading import MOST_TOML_BYTES, read_file
    from linkplan.planner.keys.key_table import DIALECT, FILES

    try:
        text = read_file(place, f"'{place}'", MOST_TOML_BYTES).decode("utf-8")  # refuses devices, whose content never ends
        said = json.loads(text) if text else {"$schema": DIALECT, "title": "linkplan problem file"}
    except (LinkplanError, ValueError, RecursionError):
        return False
    titles = [f"linkplan {name} file" for name in FILES]
    return isinstance(said, dict) and said.get("$schema") == DIALECT and said.get("title") in titles
