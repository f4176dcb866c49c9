"""The command line: `linkplan list | check | plan | track | compare | decompose | experiment | bode | tune | view | ...`.

Results go to stdout, progress and errors to stderr; `exit_codes.py` lists the exit codes. Heavy imports wait for the command
that needs them.
"""

import argparse
import importlib
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

from linkplan.cli.command_line import build_parser
from linkplan.cli.exit_codes import BAD_INPUT, DONE, NO, SIGNAL_BASE, is_of_memory, saved_fault_report
from linkplan.cli.printing import delivered, flush_streams, keep_closed_streams_closed, put, quiet, refuse, show
from linkplan.models.deadline import check, ended_by, listening
from linkplan.models.errors import CertificateError, LinkplanError, PlanError, ProblemError, one_line, shown


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Args:
        argv: the arguments; by default those of the process, which then ends after the command.
    """
    if argv is None:
        keep_closed_streams_closed()
        warnings.showwarning = _warned
    command, target, before = "", None, None  # `before`: the identity of the result at -o before the command started
    try:
        with listening(to_the_end=argv is None):
            arguments = _arguments(argv)
            if isinstance(arguments, int):
                code = arguments
            else:
                command, target = arguments.command, getattr(arguments, "output", None)
                before = _result_at(target)
                arguments.mujoco_gl = os.environ.get("MUJOCO_GL")
                if argv is None and command != "view":
                    # Otherwise MuJoCo starts a process that looks for a window library and also receives signals.
                    # `render` uses MuJoCo's contexts directly.
                    os.environ["MUJOCO_GL"] = "disable"
                    # Nor do the matplotlib settings of the working folder and the shell apply.
                    os.environ.pop("MPLBACKEND", None)
                    os.environ["MATPLOTLIBRC"] = os.devnull
                code = _run(arguments)
            check()
    except KeyboardInterrupt:
        code = _interrupted(command, target, before)
        if argv is None:
            flush_streams()
            # Without this, an interrupt during `exec` (for example in `dataclass`) would make Python end itself by SIGINT.
            os._exit(code)
    if argv is None:
        flush_streams()
    return code


def _warned(message: Warning | str, category: type[Warning], *_: object) -> None:
    """Print a warning in one line, without its source location."""
    put(sys.stderr, f"{'warning' if issubclass(category, RuntimeWarning | UserWarning) else category.__name__}: {message}\n")


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace | int:
    """Return a command's arguments, or the exit code if there is no command to run."""
    parser = build_parser()
    try:
        arguments, unknown = parser.parse_known_args(argv)
        if unknown:
            parser.refuse_unknown(arguments.command, unknown)
    except SystemExit as leave:
        return int(leave.code or 0)
    if arguments.version:
        from importlib.metadata import version

        return delivered("", put(sys.stdout, f"linkplan {version('linkplan')}\n"), DONE)
    if arguments.command is None:
        put(sys.stderr, parser.format_help())
        return BAD_INPUT
    return arguments


def _refuse_unusable_date() -> None:
    """Refuse an invalid SOURCE_DATE_EPOCH, because NumPy and matplotlib fail on it during their import."""
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None:
        return
    try:
        datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError):
        asked = "the environment variable SOURCE_DATE_EPOCH must be a time in whole seconds since 1970"
        raise ProblemError(f"{asked}, got '{shown(text, 60)}'; unset it or correct it") from None


def _run(arguments: argparse.Namespace) -> int:
    try:
        _refuse_unusable_date()
        name = "completion_command" if arguments.command == "completion" else "commands"
        module = importlib.import_module(f"linkplan.cli.{name}")
        run: Callable[[argparse.Namespace], int] = getattr(module, f"run_{arguments.command}")
        try:
            code = run(arguments)
        except PlanError as none:
            import linkplan

            plan = linkplan.Plan.of(cast("linkplan.Plan", none.plan))
            show(arguments, plan.to_dict, f"{plan.problem.name}: {plan.message}")
            code = NO
        finally:
            quiet(arguments)
        # With -o the folder is the result, so a failure to print does not change the exit code.
        saved = getattr(arguments, "output", None) is not None and not arguments.json
        return code if saved else delivered(arguments.command, getattr(arguments, "lost", None), code)
    except LinkplanError as error:
        check()
        refuse(arguments.command, by_option(arguments, one_line(error)))
        return NO if isinstance(error, CertificateError) else BAD_INPUT
    except OSError as error:
        check()
        if is_of_memory(error):
            return unforeseen(arguments.command, error)
        what = "the result cannot be written" if error.filename is None else f"'{error.filename}' cannot be read or written"
        refuse(arguments.command, one_line(f"{what}: {error.strerror or error}"))
        return BAD_INPUT
    except (Exception, SystemExit) as error:  # SystemExit: raised by a library
        check()  # some libraries replace an interrupt during their import by another error
        return unforeseen(arguments.command, error)


def _interrupted(command: str, target: str | None, before: str | None) -> int:
    """Print the state of an interrupted command's result, and return the exit code; `before` as in `main`."""
    what, result, parts = "nothing was written", _result_at(target), f"{(target or '').rstrip('/')}.unfinished"
    if result not in (None, before):
        what = f"the complete result is in '{target}'"
    elif command in ("experiment", "batch") and target and os.path.isdir(parts):
        what = f"the finished part is in '{parts}'; run the same command again to continue"
    elif command == "explore":
        what = "the page is no longer served; the problem files that it saved remain"
    refuse(command, f"interrupted; {what}")
    return SIGNAL_BASE + (ended_by() or signal.SIGINT)


def _result_at(target: str | None) -> str | None:
    """Return the identity of the result at a path; None if there is none."""
    if not target or not os.path.isdir(target):
        return None
    from linkplan.studies.output.paths import result_identity

    return result_identity(Path(target))


def by_option(arguments: argparse.Namespace, text: str) -> str:
    """Return an error message with the option's name in place of the parameter's name at its beginning."""
    name = re.match(r"(\w+)(?= (?!')|[:,]|$)", text)
    if name is None or name[1] == arguments.positional or not hasattr(arguments, name[1]):
        return text
    return f"--{name[1].replace('_', '-')}{text[name.end() :]}"


def unforeseen(command: str, error: BaseException) -> int:
    """Print one line on an internal error, with the name of the fault report's file; return the exit code."""
    try:
        text = saved_fault_report(error)
    except Exception:  # without memory no fault report can be written
        text = "not enough memory"
    refuse(command, text)
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
