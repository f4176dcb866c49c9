"""The parser of the command line: commands, arguments and options. This file has no heavy imports."""

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from linkplan.models.errors import closest, nearest, one_line
from linkplan.names import C_TRACKERS, FOLDER_FORMATS, FORMATS, LINEAR, keys_text
from linkplan.studies.cli import option_values as values
from linkplan.studies.cli.exit_codes import BAD_INPUT
from linkplan.studies.cli.printing import put

# Arguments by place: their names in refusals are words of the sentence.
POSITIONAL = ("subject", "problem", "plan", "cases", "model", "result", "file", "shell", "command")

# The shells with completion.
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
            _add(sub, "-o --output", "DIR", "write results and figures into this folder, whole")
        if report:
            _flag(sub, "--report", "write report.html, an animated page, into -o too")
        if settings:
            text = "set any key of the problem file, e.g. motion.duration_s=0.2 (TOML; a bare word is a string)"
            _repeated(sub, "--set", "KEY=VALUE", text)
        return sub

    command("list", "list the built-in models, problems, payloads, schemes and trackers", output=False, settings=False)
    text = "report on a mechanism: degrees of freedom, closure, reach, singular poses, ratios, inertias, forces, faults"
    check = command("check", text, report=True)
    _add(check, "subject", "MODEL", "a built-in model or problem, or an MJCF or problem file")
    _flag(check, "--all", "print every finding and table, not a summary of thirty lines")
    _at(check, "report inertia, gravity and effort map at this pose; may be given again")
    _selection(check)

    plan = command("plan", "plan a motion and certify it between the nodes", report=True)
    text = (
        "a built-in problem or a TOML file; paths in it (model, guess.plan) are from its own folder, else the working folder"
    )
    _add(plan, "problem", "PROBLEM", text)
    _all(plan)
    _parquet(plan, "trajectory.csv")
    _flag(plan, "--jumps", "trajectory.csv has both sides of a jump in effort, at one time")

    _flag(plan, "--prove", "prove the whole motion, however long it takes; exit code 1 if a limit is exceeded anywhere")

    text = "prove the limits of a plan at every instant, in ball arithmetic, from its saved polynomials"
    prove = command("prove", text, output=False)
    _plan(prove, anyway=False)
    _off(prove, "--no-existence", "prove the limits alone, and do not look for the model's own motion near the plan")
    _all(prove)

    batch = command("batch", "plan the cases of a batch file, each from the last one's solution", settings=False)
    _add(batch, "cases", "BATCH", "a TOML file: problem, set, and [[case]] tables or a [sweep] table")

    _parquet(batch, "every trajectory.csv")
    _engine(batch)

    text = "which motor of a list does a problem's motion, behind which gear, and by what margin"
    size = command("size", text, report=True)
    _add(size, "problem", "PROBLEM", "a built-in problem or a TOML file")
    text = "a TOML file with [[motor]] tables, or a CSV file with a motor in a row: name, peak_effort, rms_effort, ..."
    _add(size, "--motors", "FILE", text, required=True)
    _add(size, "--actuator", "NAME", "the one that gets the motors (default: the only one)")
    text = "rest without effort after each motion [s], over which the rms effort is taken, too (default: %(default)s)"
    _add(size, "--rest-s", "T", text, float, 0.0)

    track = command("track", "run one tracker on a plan in MuJoCo", report=True)
    _plan(track)
    _all(track)
    _tracker(track)
    _add(track, "--sample", "N", "run this sample of an experiment again; PLAN is the experiment's folder", int)
    _mismatch(track, 1.0, 0)
    _parquet(track, "every run's .csv")

    compare = command("compare", "run trackers side by side on a plan, nominal and with a mismatch", report=True)
    _plan(compare, "PROBLEM-or-PLAN")
    _all(compare)
    _trackers(compare)
    _mismatch(compare, 1.2, 1)
    _parquet(compare, "every run's .csv")

    experiment = command("experiment", "run trackers on many imperfect machines, the same ones for each", report=True)
    _experiment(experiment)

    text = "split each tracker's error among its causes: plan, sampling and delay, simulator, devices, model, limits"
    split = command("decompose", text, report=True)
    _plan(split, "PROBLEM-or-PLAN")
    _trackers(split)
    text = "number of random machines; one if nothing is random (default: %(default)s)"
    _add(split, "--samples", "N", text, int, 16)
    _add(split, "--seed", "N", "of all random numbers (default: %(default)s)", int, 0)

    text = "frequency response, margins and sampled stability of a feedback loop, predicted and measured in MuJoCo"
    bode = command("bode", text, report=True)
    _loop(bode)
    _add(bode, "--kp", "KP", "proportional gain [N.m/rad] (default: the problem's, 200)", float)
    _add(bode, "--kd", "KD", "derivative gain [N.m.s/rad] (default: the problem's, 1)", float)
    text = "the plant from these efforts instead of the loop: actuators or driven joints, with commas between them"
    _add(bode, "--from-effort", "NAMES", text, values.names, ())
    text = "to these positions: joints; SITE.x, .y or .z in the world; body.NAME, its angle; with commas between them"
    _add(bode, "--to-position", "NAMES", text, values.names, ())
    _off(bode, "--no-measure", "measure no response in MuJoCo; predict only")
    text = "frequencies measured, F,F,... or LOW:HIGH:N for N in equal ratios (default: 20 about crossover or resonances)"
    _add(bode, "--frequency-hz", "F", text, values.frequencies)
    _add(bode, "--amplitude-deg", "A", "of the test signal's motion (default: small)", float)
    _flag(bode, "--map", "map the stable gains over all angles, checked in MuJoCo next to the stability boundary")
    _flag(bode, "--large", "large signals past the effort limit, beside the describing function")
    _flag(bode, "--along", "analyse the tracked motion of the problem: margins at frozen instants, Floquet multipliers")

    tune = command("tune", "find PD gains or LQR weights for a bandwidth and margins at the worst pose", report=True)
    _loop(tune)
    _add(tune, "--bandwidth-hz", "F", "of each closed loop (-3 dB), at least", float, required=True)
    _add(tune, "--phase-margin-deg", "P", "at least (default: %(default)s)", float, 60.0)
    _add(tune, "--sensitivity-peak", "M", "largest |S| allowed (default: any)", float)
    _add(tune, "--settling-s", "T", "longest settling to 2 %% (default: 5 / bandwidth)", float)
    _add(tune, "--damping-ratio", "Z", "least of the closed loop's poles (default: %(default)s)", float, 0.4)
    text = "least stiffness at rest, N.m/rad or N/m (default: a small step settles within 5 %% against weight and springs)"
    _add(tune, "--stiffness", "K", text, float)

    text = "carry efforts, inertia, friction and gains between motors and output joints across a linkage, as tables"
    _transfer(command("transfer", text, report=True))

    view = command("view", "play a tracked plan in MuJoCo's interactive viewer, where keys change its gains", output=False)
    view.epilog = f"keys in the window: {keys_text()}; {EPILOG}"
    _plan(view)
    _tracker(view)
    _add(view, "--slow", "X", "times slower than real (default: %(default)s)", float, 4.0)
    _add(view, "--seconds", "S", "close the window after this time (default: when you do)", float)

    text = "draw a tracked plan as a film (.mp4, .gif) or a picture (.png), without a screen"
    _render(command("render", text, output=False))

    text = "check, plan and track the Optimus knee, with margins, into one folder (default: linkplan-demo)"
    command("demo", text, settings=False).set_defaults(output="linkplan-demo")

    text = "make one HTML file of a saved folder: animation, plots, certificate; it opens offline"
    report = command("report", text, output=False, settings=False)
    _add(report, "result", "DIR", "what plan, check, compare, experiment, decompose, bode, tune, batch, size or demo wrote")
    _add(report, "-o --output", "FILE", "default: %(default)s", default="report.html")

    text = "open a web page with sliders; the plan and the tracking result update as you move them"
    explore = command("explore", text, output=False)
    _add(explore, "subject", "MODEL-or-PROBLEM", "a built-in model or problem, or an MJCF or TOML file")
    _selection(explore)
    _file(explore, "the problem file that the page's button writes; it must not exist yet (default: problem.toml)")
    _add(explore, "--port", "N", "of 127.0.0.1 (default: a free one)", int, 0)

    text = "write a first problem file for a mechanism: a motion that it can make"
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
    text = "for the law of a plan in c: leave out rows of its tables while efforts and gains stay within this share of their"
    text += " largest values (default: 0, a row at every control instant)"
    _add(export, "--tolerance", "SHARE", text, float)
    _add(export, "--every-s", "T", "time between samples (default: ten samples in every interval of the plan's mesh)", float)
    _anyway(export)
    _selection(export)

    text = "print the JSON Schema of problem files, batch files or lists of motors, for completion in editors"
    schema = command("schema", text, output=False, settings=False)
    _add(schema, "file", "KIND", "problem, batch or motors (default: %(default)s)", default="problem", nargs="?")
    _add(schema, "-o --output", "FILE", "write it into this file")

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
    """Add an argument with a value; `names` have blanks between them."""
    parser.add_argument(*names.split(), metavar=metavar, help=text, type=kind, default=default, **further)


def _repeated(
    parser: argparse.ArgumentParser, name: str, metavar: str, text: str, kind: Callable[[str], object] = str
) -> None:
    """Add an option that may be given again."""
    parser.add_argument(name, action="append", default=[], metavar=metavar, help=text, type=kind)


def _table(parser: argparse.ArgumentParser, name: str, metavar: str, text: str, kind: Callable[[str], object]) -> None:
    """Add an option that may be given again, once for each joint."""
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
    _at(parser, "a pose to analyse; may be given again (default: over the motion or the reach)")
    _selection(parser)


def _selection(parser: argparse.ArgumentParser) -> None:
    text = "of a larger robot, read only these bodies or joints (commas between names), what hangs on them and their loops"
    _add(parser, "--keep", "NAMES", text, values.names)
    _flag(parser, "--fix-base", "lock what lies between the world and the kept bodies, and a base that no actuator moves")
    text = "lock a joint at an angle [deg], or a slide at a position [m], beside a file's locks; may be given again"
    _table(parser, "--lock", "JOINT=VALUE", text, values.joint_value)
    _add(parser, "--keyframe", "NAME", 'the keyframe of the home pose (default: "home")')
    text = "joints that get a motor within their effort limits (commas between names), where the model has no actuators"
    _add(parser, "--drive", "NAMES", text, values.names)


def _transfer(parser: argparse.ArgumentParser) -> None:
    _add(parser, "subject", "MODEL-or-PROBLEM", "a built-in model or problem, or an MJCF or TOML file")
    _selection(parser)
    _add(parser, "--joints", "A,B", "output joints, one to three, with commas between them", values.names, required=True)
    text = "interpolation error allowed, as a share of each quantity's largest size (default: %(default)s)"
    _add(parser, "--tolerance", "E", text, float, 1e-3)
    text = "the table's range of an output hinge, JOINT=LOW:HIGH in degrees (default: its whole reach); may be given again"
    _table(parser, "--range-deg", "RANGE", text, values.joint_range)
    _table(parser, "--range-m", "RANGE", "likewise, of a slide in metres", values.joint_range)
    text = "top speeds of the motors [rad/s or m/s], one for all or with commas (default: the problem's motors)"
    _add(parser, "--motor-speed", "W", text, values.numbers)
    for side, other in (("joint", "motors"), ("motor", "joints")):
        for letter, what, unit in (("kp", "stiffness", "N.m/rad"), ("kd", "damping", "N.m.s/rad")):
            text = f"{what} of the {side}s [{unit}] to carry to the {other}, one for all or with commas"
            _add(parser, f"--{side}-{letter}", "K", text, values.numbers)
    _add(parser, "--along", "PLAN", "a plan of the same model, along which the errors of models without loops are stated")
    _parquet(parser, "table.csv and inverse.csv")


def _trackers(parser: argparse.ArgumentParser) -> None:
    text = f"names with commas between them, as track takes them; or all (default: {', '.join(LINEAR)})"
    _add(parser, "--trackers", "NAMES", text, values.trackers, LINEAR)


def _tracker(parser: argparse.ArgumentParser) -> None:
    text = "pd, pd+ff, lqr, lqi, gs-pd+ff, ct or mpc; your own as module:object (default: %(default)s)"
    _add(parser, "--tracker", "NAME", text, default="pd+ff")


def _experiment(parser: argparse.ArgumentParser) -> None:
    _plan(parser, "PROBLEM-or-PLAN")
    _add(parser, "--samples", "N", "machines (default: %(default)s)", int, 200)
    _trackers(parser)
    _add(parser, "--seed", "N", "of all random numbers (default: %(default)s)", int, 0)
    text = "distribution of samples: latin-hypercube or grid; sensitivity: one-at-a-time, morris or sobol"
    text += " (default: %(default)s)"
    _add(parser, "--design", "DESIGN", text, default="latin-hypercube")
    _add(parser, "--levels", "N", "of a grid (default: %(default)s)", int, 3)
    _add(parser, "--tube-deg", "A", "success: no hinge is farther from the path (default: %(default)s)", float, 1.0)
    _add(parser, "--tube-m", "L", "success: no slide is farther from the path (default: %(default)s)", float, 0.01)
    _engine(parser)
    _add(parser, "--threads", "N", "of the simulator for each worker (default: an equal share of the cores)", int, 0)


def _all(parser: argparse.ArgumentParser) -> None:
    _flag(parser, "--all", "print every row, also where many rows of a kind are shown by the worst one")


def _engine(parser: argparse.ArgumentParser) -> None:
    _add(parser, "--workers", "N", "processes of this machine that share the work (default: %(default)s)", int, 1)
    text = "share the work among the workers of the Dask scheduler at this address, such as tcp://head:8786"
    _add(parser, "--cluster", "ADDRESS", text)


def _parquet(parser: argparse.ArgumentParser, what: str) -> None:
    _flag(parser, "--parquet", f"with -o: the table of {what} as Parquet too")


def _file(parser: argparse.ArgumentParser, text: str, *, required: bool = False) -> None:
    _add(parser, "-o --output", "FILE", text, required=required)


def _render(render: argparse.ArgumentParser) -> None:
    _plan(render)
    text = "the file to write, whole: .mp4, .gif or .png; one that linkplan did not write is left alone"
    _add(render, "-o --output", "FILE", text, required=True)
    _tracker(render)
    _add(render, "--slow", "X", "times slower than real (default: to last some 4 s)", float)
    _add(render, "--fps", "N", "frames a second (default: %(default)s)", float, 25.0)
    _add(render, "--size-px", "WxH", "of the picture in pixels (default: 800x600)", values.size, (800, 600))
    text = "a camera of the model by its name, or AZIMUTH/ELEVATION in degrees (default: the mechanism's own side)"
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
    text = "mismatch: factor on the payload's mass, on all moving masses without one (default: %(default)s)"
    _add(parser, "--mass-factor", "X", text, float, mass_factor)
    _add(parser, "--delay-periods", "N", "mismatch: further control periods of delay (default: %(default)s)", float, delay)
