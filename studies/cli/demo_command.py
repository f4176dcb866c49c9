"""The command `demo`."""

import argparse

from linkplan.studies.cli.common import output_folder
from linkplan.studies.cli.exit_codes import DONE
from linkplan.studies.cli.printing import progress, show


def run_demo(arguments: argparse.Namespace) -> int:
    """Run the whole path on the knee."""
    from linkplan.studies.demo.demo import demo

    target = output_folder(arguments)
    assert target is not None  # -o has a default
    said, text = demo(target, progress(arguments))
    show(arguments, said, text)
    return DONE
