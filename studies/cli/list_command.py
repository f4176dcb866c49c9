"""The command `list`."""

import argparse

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.catalogue import MODELS, PAYLOADS
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.planner.transcription.scheme_names import NAMES as SCHEMES
from linkplan.studies.cli.exit_codes import DONE
from linkplan.studies.cli.printing import show
from linkplan.studies.output.tables import described, folded


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
    lines = ["models", *described(MODELS), "problems", *described(problems)]
    words = {"payloads": PAYLOADS, "schemes": SCHEMES, "trackers": TRACKERS}
    lines += [folded(f"{what}: {', '.join(names)}") for what, names in words.items()]
    show(arguments, said, "\n".join(lines))
    return DONE
