"""The command `list`."""

import argparse

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.catalogue import MODELS, PAYLOADS
from linkplan.planner.files.tables import BUILT_IN as PROBLEMS
from linkplan.planner.files.tables import read_tables
from linkplan.planner.transcription.scheme_names import NAMES as SCHEMES
from linkplan.studies.cli.exit_codes import DONE
from linkplan.studies.cli.printing import show
from linkplan.studies.output.document import Facts, table_of


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
    tables = [
        table_of("", [what, "description"], list(names.items()))
        for what, names in (("model", MODELS), ("problem", problems))
    ]
    words = {"payloads": PAYLOADS, "schemes": SCHEMES, "trackers": TRACKERS}
    show(arguments, said, [*tables, Facts(rows=[(what, ", ".join(names)) for what, names in words.items()])])
    return DONE
