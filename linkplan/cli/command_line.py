"""The parser of the command line: commands, arguments and options. This file has no heavy imports."""

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NoReturn

from linkplan.api.names import C_TRACKERS, FOLDER_FORMATS, FORMATS, KEYS_TEXT, LINEAR
from linkplan.cli import option_values as values
from linkplan.cli.exit_codes import BAD_INPUT
from linkplan.cli.printing import delivered, put
from linkplan.models.errors import closest, nearest, one_line

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

# Positional arguments, and their names in error messages.
POSITIONAL = ("subject", "problem", "plan", "cases", "model", "result", "file", "shell", "command")

# The shells for which completion scripts exist.
SHELLS = ("bash", "zsh", "fish")
EPILOG = (
    "exit codes: 0 done; 1 the result is negative (no motion, an unstable loop, problems found), and a message says why;"
    " 2 bad input, or a file that cannot be read or written (a full disk), one line on stderr; 130 interrupted, 143 ended"
    " by SIGTERM; 141 stdout was closed before the result was written (use -o)"
)


class Parser(argparse.ArgumentParser):
    """argparse's parser; an error is one line on stderr."""

    def error(self, message: str) -> NoReturn:
        """Print the error, with the legal word nearest to a misspelled one, and end with exit code 2."""
        choice = re.match(r"(.*invalid choice: '(.*?)') \(choose from (.*)\)", message)
        if choice:
            message = choice[1] + nearest(choice[2], choice[3].replace("'", "").split(", ")) + f"; legal: {choice[3]}"
        message = re.sub(r"invalid (?:float|int) value: (.*)", r"takes a number, got \1", message)
        put(sys.stderr, f"{self.prog}: {one_line(message)} ({self.prog} --help says more)\n")
        raise SystemExit(BAD_INPUT)

    def print_help(self, file: "SupportsWrite[str] | None" = None) -> None:
        """Print the help; end with an exit code that is not 0 if it cannot be written."""
        del file
        lost = put(sys.stdout, self.format_help())
        if lost is not None:
            raise SystemExit(delivered(self.prog.partition(" ")[2], lost, BAD_INPUT))

    def commands(self) -> dict[str, "Parser"]:
        """Return the parsers of the commands by name."""
        return next(action.choices for action in self._actions if isinstance(action, argparse._SubParsersAction))

    def refuse_unknown(self, command: str | None, unknown: Sequence[str]) -> NoReturn:
        """Refuse arguments that a command does not take, with the option nearest to the first misspelled one."""
        parser = self if command is None else self.commands()[command]
        options = [name.lstrip("-") for action in parser._actions for name in action.option_strings]
        misspelled = next((word.partition("=")[0].lstrip("-") for word in unknown if word.startswith("--")), None)
        match = None if misspelled is None else closest(misspelled, options)
        hint = "" if match is None else f" (did you mean '--{match}'?)"
        if misspelled is not None and match is None and "set" in options:
            hint = " (keys of the problem are set by --set KEY=VALUE)"
        parser.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")


def build_parser() -> Parser:
    """Return the command line's parser."""
    parser = Parser(
        prog="linkplan",
        description="Optimal-control motion planning for closed-chain mechanisms.",
        epilog=EPILOG,
    )
    _flag(parser, "--version", "print linkplan's version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    def command(
        name: str, text: str, *, output: bool = True, settings: bool = True, report: bool = False
    ) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=EPILOG)
        _flag(sub, "--json", "print one JSON object on stdout and nothing else")
        if output:
            _add(sub, "-o --output", "DIR", "write results and figures into this folder, completely or not at all")
        if report:
            _flag(sub, "--report", "write report.html, an animated page, into -o too")
        if settings:
            text = (
                "set any key of the problem file, e.g. motion.duration_s=0.2 (a TOML value; a word without quotes is a"
                " string)"
            )
            _repeated(sub, "--set", "KEY=VALUE", text)
        return sub

    command("list", "list the built-in models, problems, payloads, schemes and trackers", output=False, settings=False)
    text = "report on a mechanism: degrees of freedom, closure, reach, singular poses, ratios, inertias, forces, faults"
    check = command("check", text, report=True)
    _add(check, "subject", "MODEL", "a built-in model or problem, or an MJCF or problem file")
    _flag(check, "--all", "print every finding and table, not a summary of thirty lines")
    _at(check, "report inertia, gravity and effort map at this pose too; may be repeated")
    _selection(check)

    plan = command("plan", "plan a motion and certify it between the nodes", report=True)
    text = (
        "a built-in problem or a TOML file; its paths (model, guess.plan) are relative to its folder or the working folder"
    )
    _add(plan, "problem", "PROBLEM", text)
    _all(plan)
    _parquet(plan, "trajectory.csv")
    _flag(plan, "--jumps", "write both sides of each jump in effort into trajectory.csv, at the same time")

    _flag(plan, "--prove", "prove the whole motion, however long it takes; exit code 1 if any limit is exceeded")

    text = "prove the limits of a plan at every instant, in ball arithmetic, from its saved polynomials"
    prove = command("prove", text, output=False)
    _plan(prove, anyway=False)
    _off(prove, "--no-existence", "prove the limits only, not that the model has a motion near the plan")
    _all(prove)

    batch = command("batch", "plan the cases of a batch file, each starting from the previous solution", settings=False)
    _add(batch, "cases", "BATCH", "a TOML file: problem, set, and [[case]] tables or a [sweep] table")

    _parquet(batch, "every trajectory.csv")
    _engine(batch)

    text = "find which motors of a list, behind which gears, can drive a problem's motion, and their margins"
    size = command("size", text, report=True)
    _add(size, "problem", "PROBLEM", "a built-in problem or a TOML file")
    text = "a TOML file with [[motor]] tables, or a CSV file with one motor per row: name, peak_effort, rms_effort, ..."
    _add(size, "--motors", "FILE", text, required=True)
    _add(size, "--actuator", "NAME", "the actuator to size (default: the only one)")
    text = "rest without effort after each motion [s]; the rms effort is taken over motion and rest (default: %(default)s)"
    _add(size, "--rest-s", "T", text, float, 0.0)

    track = command("track", "run one tracker on a plan in MuJoCo", report=True)
    _plan(track)
    _all(track)
    _tracker(track)
    _add(track, "--sample", "N", "run this sample of an experiment again; PLAN is the experiment's folder", int)
    _mismatch(track, 1.0, 0)
    _parquet(track, "every run's .csv")

    compare = command("compare", "run trackers on a plan and compare them, nominal and with a mismatch", report=True)
    _plan(compare, "PROBLEM-or-PLAN")
    _all(compare)
    _trackers(compare)
    _mismatch(compare, 1.2, 1)
    _parquet(compare, "every run's .csv")

    experiment = command("experiment", "run every tracker on the same many imperfect machines", report=True)
    _experiment(experiment)

    text = "split each tracker's error among its causes: plan, sampling and delay, simulator, devices, model, limits"
    split = command("decompose", text, report=True)
    _plan(split, "PROBLEM-or-PLAN")
    _trackers(split)
    text = "number of random machines; one if nothing is random (default: %(default)s)"
    _add(split, "--samples", "N", text, int, 16)
    _add(split, "--seed", "N", "seed of all random numbers (default: %(default)s)", int, 0)

    text = "frequency response, margins and sampled stability of a feedback loop, predicted and measured in MuJoCo"
    bode = command("bode", text, report=True)
    _loop(bode)
    _add(bode, "--kp", "KP", "proportional gain [N.m/rad] (default: the problem's, 200)", float)
    _add(bode, "--kd", "KD", "derivative gain [N.m.s/rad] (default: the problem's, 1)", float)
    text = "analyse the plant instead of the loop, from these efforts: actuators or driven joints, separated by commas"
    _add(bode, "--from-effort", "NAMES", text, values.names, ())
    text = "to these positions, separated by commas: joints; SITE.x, .y or .z in the world; body.NAME, a body's angle"
    _add(bode, "--to-position", "NAMES", text, values.names, ())
    _off(bode, "--no-measure", "predict only; do not measure responses in MuJoCo")
    text = (
        "frequencies to measure, F,F,... or LOW:HIGH:N for N with equal ratios (default: 20 about crossover or resonances)"
    )
    _add(bode, "--frequency-hz", "F", text, values.frequencies)
    _add(bode, "--amplitude-deg", "A", "amplitude of the test signal's motion (default: small)", float)
    _flag(bode, "--map", "map the stable gains over all angles, checked in MuJoCo next to the stability boundary")
    _flag(bode, "--large", "measure signals beyond the effort limit, compared with the describing function")
    _flag(bode, "--along", "analyse the tracked motion of the problem: margins at frozen instants, Floquet multipliers")

    tune = command("tune", "find PD gains or LQR weights for a bandwidth and margins at the worst pose", report=True)
    _loop(tune)
    _add(tune, "--bandwidth-hz", "F", "least bandwidth (-3 dB) of each closed loop", float, required=True)
    _add(tune, "--phase-margin-deg", "P", "least phase margin (default: %(default)s)", float, 60.0)
    _add(tune, "--sensitivity-peak", "M", "largest peak of |S| (default: no limit)", float)
    _add(tune, "--settling-s", "T", "longest settling time to 2 %% (default: 5 / bandwidth)", float)
    _add(tune, "--damping-ratio", "Z", "least damping ratio of the closed loop's poles (default: %(default)s)", float, 0.4)
    text = (
        "least stiffness at rest, N.m/rad or N/m (default: so that a small step settles within 5 %% against weight and"
        " springs)"
    )
    _add(tune, "--stiffness", "K", text, float)

    text = "convert efforts, inertia, friction and gains between motors and output joints of a linkage, as tables"
    _transfer(command("transfer", text, report=True))

    view = command("view", "play a tracked plan in MuJoCo's interactive viewer, where keys change its gains", output=False)
    view.epilog = f"keys in the window: {KEYS_TEXT}; {EPILOG}"
    _plan(view)
    _tracker(view)
    _add(view, "--slow", "X", "playback is this many times slower than real time (default: %(default)s)", float, 4.0)
    _add(view, "--seconds", "S", "close the window after this time (default: never)", float)

    text = "draw a tracked plan as a film (.mp4, .gif) or a picture (.png), without a screen"
    _render(command("render", text, output=False))

    text = "check, plan and track the Optimus knee, with margins; write all into one folder (default: linkplan-demo)"
    command("demo", text, settings=False).set_defaults(output="linkplan-demo")

    text = "make one HTML file of a saved folder: animation, plots, certificate; it opens offline"
    report = command("report", text, output=False, settings=False)
    _add(report, "result", "DIR", "a folder by plan, check, compare, experiment, decompose, bode, tune, batch, size or demo")
    _add(report, "-o --output", "FILE", "default: %(default)s", default="report.html")

    text = "open a web page with sliders; the plan and the tracking result update as you move them"
    explore = command("explore", text, output=False)
    _add(explore, "subject", "MODEL-or-PROBLEM", "a built-in model or problem, or an MJCF or TOML file")
    _selection(explore)
    _file(explore, "the problem file that the page's button writes; it must not exist yet (default: problem.toml)")
    _add(explore, "--port", "N", "port of 127.0.0.1 (default: a free one)", int, 0)

    text = "write a first problem file for a mechanism, with a feasible motion"
    new = command("new", text, output=False)
    _add(new, "model", "MODEL", "a built-in model or an MJCF file")
    _selection(new)
    _file(new, "the problem file to write; it must not exist yet (default: print it)")

    export = command("export", "write a plan, or a model in C, for other programs", output=False)
    text = "a saved plan's folder, a built-in problem or a TOML file; for c also a built-in model or an MJCF file"
    _add(export, "plan", "PLAN-or-MODEL", text)
    text = f"one of {', '.join(f'{name} ({what})' for name, what in (FORMATS | FOLDER_FORMATS).items())}"
    _add(export, "--to", "FORMAT", text, required=True)
    _file(export, "the file to write, which must not exist yet; for c a folder", required=True)
    text = "for ros, and for a model in c: the output joints as coordinates (default: the independent joints)"
    _add(export, "--joints", "A,B", text, values.names, ())
    text = f"for c: the law of a plan, one of {', '.join(C_TRACKERS)} (default: %(default)s)"
    _add(export, "--tracker", "NAME", text, default="pd+ff")
    _flag(export, "--sizes", "for a model in c: measure flash and stack even if the code is long and compiles for minutes")
    text = (
        "for the law of a plan in c: omit rows of its tables; efforts and gains then change by at most this share of their"
    )
    text += " largest values (default: 0, a row at every control instant)"
    _add(export, "--tolerance", "SHARE", text, float)
    _add(export, "--every-s", "T", "time between samples (default: ten samples per interval of the plan's mesh)", float)
    _anyway(export)
    _selection(export)

    text = "print the JSON Schema of problem files, batch files or lists of motors, for editors"
    schema = command("schema", text, output=False, settings=False)
    _add(schema, "file", "KIND", "problem, batch or motors (default: %(default)s)", default="problem", nargs="?")
    _add(schema, "-o --output", "FILE", "write the schema into this file")

    completion = command("completion", "print a shell's completion script", output=False, settings=False)
    text = f"{', '.join(SHELLS)}; e.g. linkplan completion bash > ~/.local/share/bash-completion/completions/linkplan"
    _add(completion, "shell", "SHELL", text)
    return parser


def _add(
    parser: argparse.ArgumentParser,
    names: str,
    metavar: str,
    text: str,
    kind: Callable[[str], object] = str,
    default: object = None,
    **further,
) -> None:
    """Add an argument with a value; `names` are separated by blanks."""
    parser.add_argument(*names.split(), metavar=metavar, help=text, type=kind, default=default, **further)


def _repeated(
    parser: argparse.ArgumentParser, name: str, metavar: str, text: str, kind: Callable[[str], object] = str
) -> None:
    """Add an option that may be repeated."""
    parser.add_argument(name, action="append", default=[], metavar=metavar, help=text, type=kind)


def _table(parser: argparse.ArgumentParser, name: str, metavar: str, text: str, kind: Callable[[str], object]) -> None:
    """Add an option that may be repeated, once for each joint."""
    parser.add_argument(name, action=values.Tabled, metavar=metavar, help=text, type=kind)


def _flag(parser: argparse.ArgumentParser, name: str, text: str) -> None:
    parser.add_argument(name, action="store_true", help=text)


def _off(parser: argparse.ArgumentParser, name: str, text: str) -> None:
    """Add the option --no-NAME, which sets `name` to False."""
    parser.add_argument(name, action="store_false", dest=name.removeprefix("--no-").replace("-", "_"), help=text)


def _loop(parser: argparse.ArgumentParser) -> None:
    _add(parser, "subject", "MODEL-or-PROBLEM", "a built-in model or problem, or an MJCF or TOML file")
    _add(parser, "--tracker", "LAW", "pd, pd+ff or lqr (default: %(default)s)", default="pd")
    _add(parser, "--period-s", "T", "control period [s] (default: the problem's)", float)
    _add(parser, "--delay-periods", "N", "computing delay in control periods (default: 0)", float)
    _at(parser, "a pose to analyse; may be repeated (default: several poses over the motion or the reach)")
    _selection(parser)


def _selection(parser: argparse.ArgumentParser) -> None:
    text = (
        "read only these bodies or joints of a larger robot (separated by commas), with everything attached to them and"
        " their loops"
    )
    _add(parser, "--keep", "NAMES", text, values.names)
    _flag(parser, "--fix-base", "lock the joints between the world and the kept bodies, and a base without actuators")
    text = "lock a joint at an angle [deg], or a slide at a position [m], in addition to a file's locks; may be repeated"
    _table(parser, "--lock", "JOINT=VALUE", text, values.joint_value)
    _add(parser, "--keyframe", "NAME", 'the keyframe of the home pose (default: "home")')
    text = "joints, separated by commas, that get a motor within their effort limits, if the model has no actuators"
    _add(parser, "--drive", "NAMES", text, values.names)


def _transfer(parser: argparse.ArgumentParser) -> None:
    _add(parser, "subject", "MODEL-or-PROBLEM", "a built-in model or problem, or an MJCF or TOML file")
    _selection(parser)
    _add(parser, "--joints", "A,B", "one to three output joints, separated by commas", values.names, required=True)
    text = "allowed interpolation error, as a share of each quantity's largest value (default: %(default)s)"
    _add(parser, "--tolerance", "E", text, float, 1e-3)
    text = "the table's range of an output hinge, JOINT=LOW:HIGH in degrees (default: its whole reach); may be repeated"
    _table(parser, "--range-deg", "RANGE", text, values.joint_range)
    _table(parser, "--range-m", "RANGE", "likewise, of a slide in metres", values.joint_range)
    text = "top speeds of the motors [rad/s or m/s], one for all or separated by commas (default: the problem's motors)"
    _add(parser, "--motor-speed", "W", text, values.numbers)
    for side, other in (("joint", "motors"), ("motor", "joints")):
        for letter, what, unit in (("kp", "stiffness", "N.m/rad"), ("kd", "damping", "N.m.s/rad")):
            text = f"{what} of the {side}s [{unit}] to convert to the {other}, one for all or separated by commas"
            _add(parser, f"--{side}-{letter}", "K", text, values.numbers)
    _add(parser, "--along", "PLAN", "a plan of the same model; compute the errors of models without loops along its motion")
    _parquet(parser, "table.csv and inverse.csv")


def _trackers(parser: argparse.ArgumentParser) -> None:
    text = f"names separated by commas, as for track; or all (default: {', '.join(LINEAR)})"
    _add(parser, "--trackers", "NAMES", text, values.trackers, LINEAR)


def _tracker(parser: argparse.ArgumentParser) -> None:
    text = "pd, pd+ff, lqr, lqi, gs-pd+ff, ct or mpc; your own as module:object (default: %(default)s)"
    _add(parser, "--tracker", "NAME", text, default="pd+ff")


def _experiment(parser: argparse.ArgumentParser) -> None:
    _plan(parser, "PROBLEM-or-PLAN")
    _add(parser, "--samples", "N", "machines (default: %(default)s)", int, 200)
    _trackers(parser)
    _add(parser, "--seed", "N", "seed of all random numbers (default: %(default)s)", int, 0)
    text = "distribution of samples: latin-hypercube or grid; sensitivity: one-at-a-time, morris or sobol"
    text += " (default: %(default)s)"
    _add(parser, "--design", "DESIGN", text, default="latin-hypercube")
    _add(parser, "--levels", "N", "values of each imperfection in a grid (default: %(default)s)", int, 3)
    _add(parser, "--tube-deg", "A", "a run succeeds if no hinge is farther from the path (default: %(default)s)", float, 1.0)
    _add(parser, "--tube-m", "L", "a run succeeds if no slide is farther from the path (default: %(default)s)", float, 0.01)
    _engine(parser)
    _add(parser, "--threads", "N", "threads of the simulator for each worker (default: an equal share of the cores)", int, 0)


def _all(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--all", "print every row, not only the worst one of many similar rows")


def _engine(parser: argparse.ArgumentParser) -> None:
    _add(parser, "--workers", "N", "number of processes on this machine (default: %(default)s)", int, 1)
    text = "distribute the work over the workers of the Dask scheduler at this address, such as tcp://head:8786"
    _add(parser, "--cluster", "ADDRESS", text)


def _parquet(parser: argparse.ArgumentParser, what: str) -> None:
    _flag(parser, "--parquet", f"with -o: write the table of {what} as Parquet too")


def _file(parser: argparse.ArgumentParser, text: str, *, required: bool = False) -> None:
    _add(parser, "-o --output", "FILE", text, required=required)


def _render(render: argparse.ArgumentParser) -> None:
    _plan(render)
    text = "the file to write: .mp4, .gif or .png; a file that linkplan did not write is not replaced"
    _add(render, "-o --output", "FILE", text, required=True)
    _tracker(render)
    _add(render, "--slow", "X", "playback is this many times slower than real time (default: a film of about 4 s)", float)
    _add(render, "--fps", "N", "frames per second (default: %(default)s)", float, 25.0)
    _add(render, "--size-px", "WxH", "size of the picture in pixels (default: 800x600)", values.size, (800, 600))
    text = "the name of a camera of the model, or AZIMUTH/ELEVATION in degrees (default: facing the mechanism's plane)"
    _add(render, "--camera", "VIEW", text)
    _flag(render, "--there-and-back", "play a film forwards and backwards, so that it repeats without a jump")
    text = "a picture of one instant, with the plan's ghost (default: several instants in one picture)"
    _add(render, "--at-s", "T", text, float)
    _add(render, "--instants", "N", "number of instants in one picture (default: %(default)s)", int, 7)


def _plan(parser: argparse.ArgumentParser, metavar: str = "PLAN", *, anyway: bool = True) -> None:
    _add(parser, "plan", metavar, "a saved plan's folder, a built-in problem or a TOML file")
    if anyway:
        _anyway(parser)


def _anyway(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--anyway", "run a saved plan that does not pass its certificate, with a note and exit code 1")


def _at(parser: argparse.ArgumentParser, text: str) -> None:
    _repeated(parser, "--at-deg", "JOINT=ANGLE", f"{text}; degrees", values.pose)
    _repeated(parser, "--at-m", "JOINT=POSITION", "likewise, of slides in metres", values.pose)


def _mismatch(parser: argparse.ArgumentParser, mass_factor: float, delay: float) -> None:
    text = "mismatch: factor on the payload's mass, or on all moving masses without a payload (default: %(default)s)"
    _add(parser, "--mass-factor", "X", text, float, mass_factor)
    _add(parser, "--delay-periods", "N", "mismatch: further control periods of delay (default: %(default)s)", float, delay)
