"""The commands. Each calls the public function with the same name, and prints or writes the result."""

import argparse
import contextlib
import inspect
import json
import shlex
from collections.abc import Container, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import linkplan
from linkplan.api import names
from linkplan.api.command import command
from linkplan.cli.exit_codes import DONE, NO, ExitCode, saved_fault_report
from linkplan.cli.printing import Progress, flush_streams, progress, refuse, show
from linkplan.models.errors import PlanFileError, ProblemError

if TYPE_CHECKING:
    from linkplan.api.inputs import Source
    from linkplan.api.plans import Plan
    from linkplan.studies.output.document import Block
    from linkplan.studies.output.result import Result, Shown


# Options that write additional files into a result's folder.
_WITH_OUTPUT = {"report": "report.html", "parquet": "tables as Parquet", "jumps": "both sides of jumps"}


@contextlib.contextmanager
def naming(option: str) -> Iterator[None]:
    """Prefix errors about an option's value with the option's name."""
    try:
        yield
    except (PlanFileError, ProblemError) as error:
        raise type(error)(f"{option}: {error}".replace(f"{option}: {option}", option)) from error


def output_folder(arguments: argparse.Namespace) -> Path | None:
    """Return the output folder; an unusable folder is refused before the work starts."""
    if arguments.output is None:
        for option, what in _WITH_OUTPUT.items():
            if getattr(arguments, option, False):
                raise ProblemError(f"--{option} writes {what} into the folder of -o; add -o DIR")
        return None
    return folder_asked(arguments)


def folder_asked(arguments: argparse.Namespace) -> Path:
    """Return the folder of -o after a check that it can be written."""
    if not arguments.output:
        raise ProblemError("-o takes a folder, got an empty name")
    from linkplan.studies.output.paths import folder_to_write, require_parquet

    if getattr(arguments, "parquet", False):
        require_parquet("--parquet")
    with naming("-o"):
        return folder_to_write(arguments.output, f"{arguments.command}.json")


def file_asked(arguments: argparse.Namespace) -> Path:
    """Return the file of -o."""
    if not arguments.output:
        raise ProblemError("-o takes a file, got an empty name")
    return Path(arguments.output)


def new_file(arguments: argparse.Namespace) -> Path | None:
    """Return the file of -o; an existing or unwritable file is refused before the work starts."""
    if arguments.output is None:
        return None
    from linkplan.studies.output.paths import file_to_write

    with naming("-o"):
        return file_to_write(file_asked(arguments))


def source_asked(arguments: argparse.Namespace, name: str, parameters: Container[str]) -> "Source":
    """Return a source with the options for reading it, except those that the function takes as its own `parameters`."""
    from linkplan.api.inputs import Source

    selection = {key: getattr(arguments, key, None) for key in names.SELECTION if key not in parameters}
    return Source(
        name=name,
        settings=tuple(arguments.set),
        selection={key: list(value) if isinstance(value, tuple) else value for key, value in selection.items() if value},
        anyway=getattr(arguments, "anyway", False),
    )


def answered(arguments: argparse.Namespace, result: "Result | Plan | Shown") -> ExitCode:
    """Print a result and return its exit code: 1 if the result is negative."""
    show(arguments, result.to_dict, result.blocks)
    return DONE if result.passed else NO


def called(arguments: argparse.Namespace, say: Progress | None, **further: object):
    """Call the public function with the command's name and options, and return its result."""
    function = getattr(linkplan, arguments.command)
    parameters = inspect.signature(function).parameters
    given = {name: getattr(arguments, name) for name in parameters if hasattr(arguments, name)} | further
    if "progress" in parameters:
        given["progress"] = say
    first = next(iter(parameters))
    name = given.get(first)
    if hasattr(arguments, "set") and isinstance(name, str):
        given[first] = source_asked(arguments, name, parameters)
    return function(**given)


def run_study(arguments: argparse.Namespace) -> int:
    """Run a study, and save, draw and print its result; return 1 if the result is negative."""
    target, say = output_folder(arguments), progress(arguments)
    result = called(arguments, say)
    if target is not None:
        further = {option: getattr(arguments, option) for option in _WITH_OUTPUT if hasattr(arguments, option)}
        result.save(target, **further)
    return answered(arguments, result)


run_track = run_compare = run_decompose = run_bode = run_tune = run_transfer = run_size = run_study


def run_plan(arguments: argparse.Namespace) -> int:
    """Plan a motion; 1 if there is none."""
    target, say = output_folder(arguments), progress(arguments)
    plan = called(arguments, say)
    if plan.passed and target is not None:
        further = {"jumps": True} if arguments.jumps else {}
        plan.save(target, parquet=arguments.parquet, report=arguments.report, **further)
    if target is not None:
        say.keep(f"saved in {target}" if plan.passed else f"nothing written: {plan.status}")
    return answered(arguments, plan)


def run_prove(arguments: argparse.Namespace) -> int:
    """Prove a plan's limits at every instant; 1 if one of them is refuted."""
    return answered(arguments, called(arguments, progress(arguments)))


def run_batch(arguments: argparse.Namespace) -> int:
    """Run or continue a batch or an experiment, which writes its folder itself; 1 if the result is negative."""
    target, say = output_folder(arguments), progress(arguments)
    result = called(arguments, say, folder=target)
    if target is not None:
        say.keep(f"saved in {target}")
        if getattr(arguments, "report", False):
            result.report(target / "report.html")
    return answered(arguments, result)


run_experiment = run_batch


def run_view(arguments: argparse.Namespace) -> int:
    """Play a tracked plan in the viewer; 1 if the plan does not pass."""
    said = called(arguments, progress(arguments))
    if arguments.json:
        show(arguments, said, "")
    return DONE if said["passed"] else NO


def run_render(arguments: argparse.Namespace) -> int:
    """Draw a tracked plan as a film or a picture; 1 if the plan does not pass."""
    return answered(arguments, called(arguments, progress(arguments), path=file_asked(arguments)))


def run_demo(arguments: argparse.Namespace) -> int:
    """Run all studies of the knee."""
    said, blocks = called(arguments, progress(arguments), folder=folder_asked(arguments))
    show(arguments, said, blocks)
    return DONE


def run_report(arguments: argparse.Namespace) -> int:
    """Write the report of a saved folder as one HTML file."""
    say = progress(arguments)
    path = called(arguments, say, path=file_asked(arguments))
    size = path.stat().st_size
    show(arguments, {"report": str(path), "bytes": size}, f"{path}: {size / 1e6:.2g} MB, opens in any browser, offline too")
    return DONE


def run_explore(arguments: argparse.Namespace) -> int:
    """Serve the page with a problem's sliders until Ctrl-C."""

    def tell(error: BaseException) -> None:
        refuse("explore", saved_fault_report(error))

    page = called(arguments, progress(arguments), path=new_file(arguments), tell=tell)
    said = {"problem": page.name, "address": page.address}
    show(arguments, said, f"open {page.address} in a browser; Ctrl-C ends")
    flush_streams()  # flushed, because the user needs the address while the command runs
    page.serve()
    return DONE


def run_new(arguments: argparse.Namespace) -> int:
    """Write a problem file for a mechanism; 1 if no motion was found for it."""
    say = progress(arguments)
    target = new_file(arguments)
    found = called(arguments, say, path=target)
    verdict, notes = found.verdict, [f"note: {note}" for note in found.notes]
    if target is None:
        for line in (f"{found.description}: {verdict}", *notes):
            say.keep(line)
        show(arguments, found.to_dict, found.text.rstrip("\n"))
    else:
        lines = [f"{target}: {found.description}", f"{verdict[0].upper()}{verdict[1:]}", *notes]
        show(arguments, found.to_dict, "\n".join(lines))
    return DONE if found.planned else NO


def run_export(arguments: argparse.Namespace) -> int:
    """Write a plan or a model for another program; 1 if the plan does not pass."""
    say = progress(arguments)
    with naming("-o"):
        path = folder_asked(arguments) if arguments.to in names.FOLDER_FORMATS else new_file(arguments)
    return answered(arguments, called(arguments, say, path=path))


@command("list the built-in models, problems, payloads, schemes and trackers")
def list_command() -> "tuple[dict, list[Block]]":
    """Return the built-in names as JSON and as blocks."""
    from linkplan.studies.output.document import Facts, table_of

    problems = names.problem_descriptions()
    words = {"payloads": names.PAYLOADS, "schemes": names.SCHEMES, "trackers": names.TRACKERS}
    said = {"models": dict(names.MODELS), "problems": problems} | {what: list(some) for what, some in words.items()}
    tables = [
        table_of("", [what, "description"], list(rows.items()))
        for what, rows in (("model", names.MODELS), ("problem", problems))
    ]
    return said, [*tables, Facts(rows=[(what, ", ".join(some)) for what, some in words.items()])]


def run_list(arguments: argparse.Namespace) -> int:
    """Print the built-in names."""
    show(arguments, *list_command())
    return DONE


def run_schema(arguments: argparse.Namespace) -> int:
    """Print the JSON Schema of a kind of file, or write it into a file."""
    said = called(arguments, None, path=arguments.output)
    if arguments.output is None or arguments.json:
        show(arguments, said, json.dumps(said, indent=2))
    return DONE


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
