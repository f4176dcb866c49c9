"""The command line: `linkplan list | check | plan | batch | track | compare | bode | tune | view | schema | demo`.

Results go to stdout, progress and refusals to stderr. Exit codes: 0 done; 1 the answer is no (infeasible, unstable,
problems found), said in a sentence; 2 bad input or a disk that refuses, one line; 130 or 143 ended by a signal; 141 nobody
read the result. Heavy imports wait for the command that needs them.
"""

import argparse
import importlib
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from linkplan.models.errors import CertificateError, LinkplanError, one_line
from linkplan.models.interrupts import check, ended_by, listening
from linkplan.studies.cli.exit_codes import BAD_INPUT, BY_SIGNAL, DONE, NO
from linkplan.studies.cli.parser import Parser
from linkplan.studies.cli.printing import delivered, keep_closed_streams_closed, let_go, put, refuse

# The module of each command, loaded when the command is given.
_MODULES = {
    "list": "list_command",
    "check": "check_command",
    "plan": "plan_commands",
    "batch": "plan_commands",
    "track": "tracking_commands",
    "compare": "tracking_commands",
    "view": "tracking_commands",
    "bode": "feedback_loop_commands",
    "tune": "feedback_loop_commands",
    "schema": "schema_command",
    "demo": "demo_command",
}

_EPILOG = """exit codes: 0 done; 1 the answer is no (infeasible, unstable, problems found), said in a sentence;
2 bad input, or a file that cannot be read or written (a full disk), one line on stderr;
130 interrupted, 143 ended by SIGTERM; 141 the reader of stdout left before the result, which no -o has saved"""


def build_parser() -> Parser:
    """Return the command line's parser."""
    parser = Parser(
        prog="linkplan",
        description="Optimal-control motion planning for closed-chain mechanisms.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print linkplan's version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    def command(name: str, text: str, *, output: bool = True, settings: bool = True) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=_EPILOG)
        parser.commands[name] = sub
        sub.formatter_class = argparse.RawDescriptionHelpFormatter
        sub.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else")
        if output:
            sub.add_argument("-o", "--output", metavar="DIR", help="write results and figures into this folder, whole")
        if settings:
            sub.add_argument(
                "--set",
                action="append",
                default=[],
                metavar="KEY=VALUE",
                help="set any key of the problem file, e.g. motion.duration_s=0.2 (TOML; a bare word is a string)",
            )
        return sub

    command("list", "list the built-in models, problems, payloads, schemes and trackers", output=False, settings=False)
    text = "report on a mechanism: degrees of freedom, closure, reach, singular poses, ratios, inertias, forces, faults"
    check = command("check", text)
    check.add_argument("model", metavar="MODEL", help="a built-in model or problem, or an MJCF or problem file")
    _at(check, "report inertia, gravity and effort map at this pose; may be given again")

    plan = command("plan", "plan a motion and certify it between the nodes")
    text = (
        "a built-in problem or a TOML file; paths in it (model, guess.plan) are from its own folder, else the working folder"
    )
    plan.add_argument("problem", metavar="PROBLEM", help=text)
    plan.add_argument("--jumps", action="store_true", help="trajectory.csv has both sides of a jump in effort, at one time")

    batch = command("batch", "plan the cases of a batch file, each from the last one's solution", settings=False)
    batch.add_argument("batch", metavar="BATCH", help="a TOML file: problem, set, and [[case]] tables or a [sweep] table")

    track = command("track", "run one tracker on a plan in MuJoCo")
    track.add_argument("plan", metavar="PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    track.add_argument("--tracker", default="pd+ff", metavar="NAME", help="pd, pd+ff or lqr (default: %(default)s)")
    _mismatch(track, 1.0, 0)

    compare = command("compare", "run all trackers side by side on a plan, nominal and with a mismatch")
    compare.add_argument("plan", metavar="PROBLEM-or-PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    _mismatch(compare, 1.2, 1)

    bode = command(
        "bode", "frequency response, margins and sampled stability of a feedback loop, predicted and measured in MuJoCo"
    )
    _loop(bode)
    bode.add_argument("--kp", type=float, metavar="KP", help="proportional gain [N.m/rad] (default: the problem's, 200)")
    bode.add_argument("--kd", type=float, metavar="KD", help="derivative gain [N.m.s/rad] (default: the problem's, 1)")
    bode.add_argument(
        "--measure",
        default="sinestream",
        metavar="HOW",
        help="sinestream, multisine, chirp or none (default: %(default)s)",
    )
    bode.add_argument("--from-hz", type=float, metavar="F", help="lowest frequency measured (default: about the crossover)")
    bode.add_argument("--to-hz", type=float, metavar="F", help="highest frequency measured, below half the sampling rate")
    bode.add_argument("--frequencies", type=int, metavar="N", help="how many frequencies are measured (default: 20)")
    bode.add_argument("--amplitude-deg", type=float, metavar="A", help="of the test signal's motion (default: small)")
    bode.add_argument(
        "--map",
        action="store_true",
        help="map the stable gains over all angles, checked in MuJoCo next to the stability boundary",
    )
    bode.add_argument(
        "--large", action="store_true", help="large signals past the effort limit, beside the describing function"
    )
    bode.add_argument(
        "--along",
        action="store_true",
        help="analyse the tracked motion of the problem: margins at frozen instants, Floquet multipliers",
    )

    tune = command("tune", "find PD gains or LQR weights for a bandwidth and margins at the worst angle")
    _loop(tune)
    tune.add_argument("--bandwidth-hz", type=float, required=True, metavar="F", help="of the closed loop, at least")
    tune.add_argument("--phase-margin-deg", type=float, default=60.0, metavar="P", help="at least (default: %(default)s)")
    tune.add_argument("--sensitivity-peak", type=float, metavar="M", help="largest |S| allowed (default: any)")

    view = command("view", "play a tracked plan in MuJoCo's interactive viewer", output=False)
    view.add_argument("plan", metavar="PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    _anyway(view)
    view.add_argument("--tracker", default="pd+ff", metavar="NAME", help="pd, pd+ff or lqr (default: %(default)s)")
    view.add_argument("--slow", type=float, default=4.0, metavar="X", help="times slower than real (default: %(default)s)")
    view.add_argument("--seconds", type=float, metavar="S", help="close the window after this time (default: when you do)")

    schema = command(
        "schema", "print the JSON Schema of problem files, by which editors complete them", output=False, settings=False
    )
    schema.add_argument("file", nargs="?", default="problem", metavar="FILE", help="problem or batch (default: %(default)s)")
    schema.add_argument("-o", "--output", metavar="FILE", help="write it into this file")

    text = "run the whole path on the Optimus knee into one folder (default: linkplan-demo)"
    command("demo", text, settings=False).set_defaults(output="linkplan-demo")
    return parser


def _loop(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL-or-PROBLEM", help="a built-in model or problem, or an MJCF or TOML file")
    parser.add_argument("--tracker", default="pd", metavar="NAME", help="pd, pd+ff or lqr (default: %(default)s)")
    parser.add_argument("--period-s", type=float, metavar="T", help="control period [s] (default: the problem's, 1e-4)")
    parser.add_argument("--delay-periods", type=float, metavar="N", help="computing delay in control periods (default: 0)")
    _at(parser, "a pose to analyse; may be given again (default: over the motion or the reach)")


def _anyway(parser: argparse.ArgumentParser) -> None:
    text = "run a saved plan that does not pass its certificate, with a word and exit code 1"
    parser.add_argument("--anyway", action="store_true", help=text)


def _at(parser: argparse.ArgumentParser, text: str) -> None:
    text += "; degrees, metres for a slide"
    parser.add_argument("--at-deg", action="append", default=[], metavar="JOINT=ANGLE", help=text)


def _mismatch(parser: argparse.ArgumentParser, mass_factor: float, delay: int) -> None:
    _anyway(parser)
    parser.add_argument(
        "--mass-factor",
        type=float,
        default=mass_factor,
        metavar="X",
        help="mismatch: factor on the payload's mass, on all moving masses without one (default: %(default)s)",
    )
    parser.add_argument(
        "--delay-periods",
        type=int,
        default=delay,
        metavar="N",
        help="mismatch: further control periods of delay (default: %(default)s)",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Before:
    """A command, its -o, and which folder stood there before it began: a new result is another folder."""

    command: str = ""
    target: str | None = None
    folder: tuple[int, int] | None = None


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code.

    Args:
        argv: its words; by default those of the process, which ends afterwards.
    """
    if argv is None:
        keep_closed_streams_closed()
    before = _Before()
    try:
        with listening(to_the_end=argv is None):
            arguments = _arguments(argv)
            if isinstance(arguments, int):
                code = arguments
            else:
                target = getattr(arguments, "output", None)
                before = _Before(command=arguments.command, target=target, folder=_folder_at(target))
                if argv is None and before.command != "view":
                    # Nothing is rendered; MuJoCo would look for a window library, in a process that signals reach too.
                    os.environ.setdefault("MUJOCO_GL", "disable")
                code = _run(arguments)
            check()
    except KeyboardInterrupt:
        code = _interrupted(before)
        if argv is None:
            let_go()
            # Python ends itself by SIGINT where an interrupt went through its exec, as of a dataclass that is being made.
            os._exit(code)
    if argv is None:
        let_go()
    return code


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace | int:
    """Return a command's arguments, or the exit code where there is nothing to run."""
    parser = build_parser()
    try:
        parser.refuse_misspelled(sys.argv[1:] if argv is None else argv)
        arguments, extra = parser.parse_known_args(argv)
        if extra and arguments.command is not None:
            parser.refuse_extra(arguments.command, extra, sets=bool(getattr(arguments, "set", None)))
    except SystemExit as leave:
        return int(leave.code or 0)
    if arguments.version:
        from importlib.metadata import version

        return delivered("", put(sys.stdout, f"linkplan {version('linkplan')}\n"), DONE)
    if arguments.command is None:
        put(sys.stderr, parser.format_help())
        return BAD_INPUT
    return arguments


def _run(arguments: argparse.Namespace) -> int:
    try:
        module = importlib.import_module(f"linkplan.studies.cli.{_MODULES[arguments.command]}")
        run: Callable[[argparse.Namespace], int] = getattr(module, f"run_{arguments.command}")
        code, lost = run(arguments), getattr(arguments, "lost", None)
        # With -o the folder is the result, and what is printed is about it.
        saved = getattr(arguments, "output", None) is not None and not arguments.json
        return code if saved else delivered(arguments.command, lost, code)
    except LinkplanError as error:
        check()
        refuse(arguments.command, one_line(error))
        return NO if isinstance(error, CertificateError) else BAD_INPUT
    except OSError as error:
        check()
        refuse(arguments.command, f"the result cannot be written: {error.strerror or error}")
        return BAD_INPUT
    except Exception as error:
        check()  # libraries make other errors of an interrupt that comes while they are loaded
        return unforeseen(arguments.command, error)


def _interrupted(before: _Before) -> int:
    """Say what an interrupted command leaves, and return its exit code."""
    what, folder = "nothing was written", _folder_at(before.target)
    if folder is not None and folder != before.folder:
        what = f"the result is in '{before.target}', whole"
    refuse(before.command, f"interrupted; {what}")
    return BY_SIGNAL + (ended_by() or signal.SIGINT)


def _folder_at(target: str | None) -> tuple[int, int] | None:
    """Return which folder stands at a place; None where there is none."""
    try:
        found = os.stat(target) if target else None
    except (OSError, ValueError):
        return None
    return None if found is None else (found.st_dev, found.st_ino)


def unforeseen(command: str, error: BaseException) -> int:
    """Say in one line that linkplan itself failed, and where to find what its makers need to know; return the exit code."""
    import tempfile
    import traceback
    from importlib.metadata import version

    if isinstance(error, MemoryError):
        what = "there is not enough memory for it"
    else:
        what = f"a fault of linkplan's own ({type(error).__name__}: {one_line(error)[:200]})"
    said = "".join(traceback.format_exception(error)).encode("utf-8", "backslashreplace")
    about = f"linkplan {version('linkplan')}, Python {sys.version}\narguments: {sys.argv[1:]!r}\n\n"
    told = about.encode("utf-8", "backslashreplace")
    try:
        with tempfile.NamedTemporaryFile(prefix="linkplan-fault-", suffix=".txt", delete=False) as file:
            file.write(told + said)
        send = f"; please send '{file.name}' to linkplan's makers"
    except OSError:
        send = ""
    refuse(command, f"{what}{send}")
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
