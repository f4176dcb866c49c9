"""The command `list`."""

import argparse

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.catalogue import MODELS, PAYLOADS
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.planner.transcription.scheme_names import NAMES as SCHEMES
from linkplan.studies.cli.exit_codes import DONE
from linkplan.studies.cli.printing import show


def run_list(arguments: argparse.Namespace) -> int:
    """Print the built-in names."""
    problems = {name: read_tables(name)[1].get("description", "") for name in PROBLEMS}
    said = {
        "models": dict(MODELS),
        "problems": problems,
        "payloads": list(PAYLOADS),
        "schemes": list(SCHEMES),
        "trackers": list(TRACKERS),
    }
    lines = ["models"]
    lines += [f"  {name:20s}  {text}" for name, text in MODELS.items()]
    lines += ["problems", *(f"  {name:20s}  {text}" for name, text in problems.items())]
    lines += [f"payloads: {', '.join(PAYLOADS)}", f"schemes: {', '.join(SCHEMES)}", f"trackers: {', '.join(TRACKERS)}"]
    show(arguments, said, "\n".join(lines))
    return DONE
