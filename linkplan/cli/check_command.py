"""The command `check`, which also names the next command."""

import argparse
import shlex
from typing import TYPE_CHECKING

from linkplan.cli.commands import called, output_folder
from linkplan.cli.exit_codes import DONE, NO
from linkplan.cli.printing import show

if TYPE_CHECKING:
    from linkplan.studies.output.document import Block
    from linkplan.studies.output.result import Result


def run_check(arguments: argparse.Namespace) -> int:
    """Report on a mechanism and its quantities along a path; 1 if problems are found."""
    target = output_folder(arguments)
    found = called(arguments, None)
    if target is not None:
        found.save(target, report=arguments.report)

    def blocks() -> "list[Block]":
        summed_up = (
            not (arguments.all or hasattr(arguments, "at_deg") or hasattr(arguments, "at_m")) or found.mechanism is None
        )
        return [*found.summary(), *_what_is_next(found, arguments)] if summed_up else found.blocks()

    show(arguments, found.to_dict, blocks)
    return DONE if found.passed else NO


def _what_is_next(found: "Result", arguments: argparse.Namespace) -> "list[Block]":
    from linkplan.api.inputs import is_problem
    from linkplan.studies.output.document import Facts

    subject, of_problem = shlex.join([arguments.subject, *_options(arguments)]), is_problem(arguments.subject)
    if found.mechanism is None:
        known = bool(found.home) and not of_problem
        return [Facts(rows=[("next", f"linkplan new {subject} -o problem.toml starts from that pose")])] if known else []
    if found.mechanism.n_u == 0 and not found.joints_to_drive:
        further = f"linkplan check {subject}, with an actuator that a plan can use in the model's <actuator>"
    elif found.mechanism.n_u == 0:
        driven = f"{subject} --drive {shlex.quote(','.join(found.joints_to_drive))}"
        command = f"check {driven}" if of_problem else f"new {driven} -o problem.toml"
        further = f"linkplan {command} puts motors on these joints"
    elif of_problem:
        further = f"linkplan plan {subject} -o planned"
    elif found.floats:
        further = (
            f"linkplan new {subject} -o problem.toml writes a first motion on the fixed base; --keep NAMES --fix-base takes"
            " one chain with its loops out of the robot"
        )
    else:
        further = f"linkplan new {subject} -o problem.toml writes a first motion and names what it changes"
    return [Facts(rows=[("next", further), ("everything", f"linkplan check {subject} --all")])]


def _options(arguments: argparse.Namespace) -> list[str]:
    """Return the options of this command that select a part of the model or set keys; the next command repeats them."""
    words = [
        word
        for key in ("keep", "drive")
        if (names := getattr(arguments, key, None))
        for word in (f"--{key}", ",".join(names))
    ]
    words += ["--fix-base"] if arguments.fix_base else []
    words += [word for joint, value in getattr(arguments, "lock", {}).items() for word in ("--lock", f"{joint}={value:g}")]
    words += ["--keyframe", arguments.keyframe] if hasattr(arguments, "keyframe") else []
    return words + [word for setting in arguments.set for word in ("--set", setting)]
