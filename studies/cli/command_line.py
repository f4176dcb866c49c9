"""The parser of the command line: commands, arguments and options. This file has no heavy imports."""

import argparse
import sys
from typing import NoReturn

from linkplan.controllers.controls import keys_said
from linkplan.models.errors import one_line
from linkplan.studies.cli.exit_codes import BAD_INPUT
from linkplan.studies.cli.streams import put
from linkplan.studies.export.formats import C_TRACKERS, FOLDER_FORMATS, FORMATS

# The shells with completion.
SHELLS = ("bash", "zsh", "fish")
EPILOG = (
    "exit codes: 0 done; 1 the answer is no (infeasible, unstable, problems found), with a sentence; 2 bad input, or a file"
    " that cannot be read or written (a full disk), one line on stderr; 130 interrupted, 143 ended by SIGTERM; 141 stdout"
    " was closed before the result was written (use -o)"
)


class Parser(argparse.ArgumentParser):
    """argparse's parser; an error is one line on stderr."""

    def error(self, message: str) -> NoReturn:
        """Print the error and end with exit code 2."""
        put(sys.stderr, f"{self.prog}: {one_line(message)} ({self.prog} --help says more)\n")
        raise SystemExit(BAD_INPUT)


def build_parser() -> Parser:
    """Return the command line's parser."""
    parser = Parser(
        prog="linkplan",
        description="Optimal-control motion planning for closed-chain mechanisms.",
        epilog=EPILOG,
    )
    parser.add_argument("--version", action="store_true", help="print linkplan's version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    def command(
        name: str, text: str, *, output: bool = True, settings: bool = True, report: bool = False
    ) -> argparse.ArgumentParser:
        sub = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=EPILOG)
        sub.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else")
        if output:
            sub.add_argument("-o", "--output", metavar="DIR", help="write results and figures into this folder, whole")
        if report:
            sub.add_argument("--report", action="store_true", help="write report.html, an animated page, into -o too")
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
    check = command("check", text, report=True)
    check.add_argument("model", metavar="MODEL", help="a built-in model or problem, or an MJCF or problem file")
    check.add_argument("--all", action="store_true", help="print every finding and table, not a summary of thirty lines")
    _at(check, "report inertia, gravity and effort map at this pose; may be given again")
    _selection(check)

    plan = command("plan", "plan a motion and certify it between the nodes", report=True)
    text = (
        "a built-in problem or a TOML file; paths in it (model, guess.plan) are from its own folder, else the working folder"
    )
    plan.add_argument("problem", metavar="PROBLEM", help=text)
    _parquet(plan, "trajectory.csv")
    plan.add_argument("--jumps", action="store_true", help="trajectory.csv has both sides of a jump in effort, at one time")

    text = "prove the whole motion, whatever it takes; exit code 1 if a limit is exceeded anywhere"
    plan.add_argument("--prove", action="store_true", help=text)

    text = "prove the limits of a plan at every instant, in ball arithmetic, from its saved polynomials"
    prove = command("prove", text, output=False)
    prove.add_argument("plan", metavar="PLAN", help="a saved plan's folder, a built-in problem or a TOML file")

    batch = command("batch", "plan the cases of a batch file, each from the last one's solution", settings=False)
    batch.add_argument("batch", metavar="BATCH", help="a TOML file: problem, set, and [[case]] tables or a [sweep] table")

    _parquet(batch, "every trajectory.csv")
    _engine(batch)

    track = command("track", "run one tracker on a plan in MuJoCo", report=True)
    track.add_argument("plan", metavar="PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    _tracker(track)
    text = "run this sample of an experiment again; PLAN is the experiment's folder"
    track.add_argument("--sample", type=int, metavar="N", help=text)
    _mismatch(track, 1.0, 0)
    _parquet(track, "every run's .csv")

    compare = command("compare", "run trackers side by side on a plan, nominal and with a mismatch", report=True)
    compare.add_argument("plan", metavar="PROBLEM-or-PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    text = "names with commas between them, as track takes them; or all (default: %(default)s)"
    compare.add_argument("--trackers", default="pd, pd+ff, lqr", metavar="NAMES", help=text)
    _mismatch(compare, 1.2, 1)
    _parquet(compare, "every run's .csv")

    experiment = command("experiment", "run trackers on many imperfect machines, the same ones for each", report=True)
    _experiment(experiment)

    text = "split each tracker's error among its causes: plan, sampling and delay, simulator, devices, model, limits"
    split = command("decompose", text, report=True)
    split.add_argument("plan", metavar="PROBLEM-or-PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    _anyway(split)
    text = "names with commas between them, as compare takes them; or all (default: %(default)s)"
    split.add_argument("--trackers", default="pd, pd+ff, lqr", metavar="NAMES", help=text)
    text = "machines that [imperfections] are drawn for; one where nothing is random (default: %(default)s)"
    split.add_argument("--samples", type=int, default=16, metavar="N", help=text)
    split.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers (default: %(default)s)")

    text = "frequency response, margins and sampled stability of a feedback loop, predicted and measured in MuJoCo"
    bode = command("bode", text, report=True)
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

    tune = command("tune", "find PD gains or LQR weights for a bandwidth and margins at the worst pose", report=True)
    _loop(tune)
    tune.add_argument("--bandwidth-hz", type=float, required=True, metavar="F", help="of each closed loop (-3 dB), at least")
    tune.add_argument("--phase-margin-deg", type=float, default=60.0, metavar="P", help="at least (default: %(default)s)")
    tune.add_argument("--sensitivity-peak", type=float, metavar="M", help="largest |S| allowed (default: any)")
    tune.add_argument("--settling-s", type=float, metavar="T", help="longest settling to 2 %% (default: 5 / bandwidth)")
    tune.add_argument("--damping-ratio", type=float, metavar="Z", help="least of the closed loop's poles (default: 0.4)")

    text = "carry efforts, inertia, friction and gains between motors and output joints across a linkage, as tables"
    _transfer(command("transfer", text, report=True))

    view = command("view", "play a tracked plan in MuJoCo's interactive viewer, where keys change its gains", output=False)
    view.epilog = f"keys in the window: {keys_said()}; {EPILOG}"
    view.add_argument("plan", metavar="PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    _anyway(view)
    _tracker(view)
    view.add_argument("--slow", type=float, default=4.0, metavar="X", help="times slower than real (default: %(default)s)")
    view.add_argument("--seconds", type=float, metavar="S", help="close the window after this time (default: when you do)")

    text = "draw a tracked plan as a film (.mp4, .gif) or a picture (.png), without a screen"
    _render(command("render", text, output=False))

    text = "run the whole path on the Optimus knee into one folder (default: linkplan-demo)"
    command("demo", text, settings=False, report=True).set_defaults(output="linkplan-demo")

    text = "make one HTML file of a saved folder: animation, plots, certificate; it opens offline"
    report = command("report", text, output=False, settings=False)
    report.add_argument(
        "folder", metavar="DIR", help="what plan, check, compare, experiment, decompose, bode, tune, batch or demo wrote"
    )
    report.add_argument("-o", "--output", metavar="FILE", default="report.html", help="default: %(default)s")

    text = "vary a problem by sliders on a page of this machine: the certified plan and its tracking follow"
    explore = command("explore", text, output=False)
    explore.add_argument("model", metavar="MODEL-or-PROBLEM", help="a built-in model or problem, or an MJCF or TOML file")
    _selection(explore)
    _file(explore, "the problem file that the page's button writes; it must not be there (default: problem.toml)")
    explore.add_argument("--port", type=int, default=0, metavar="N", help="of 127.0.0.1 (default: a free one)")

    text = "write a first problem file for a mechanism: a motion that it can make, every option in comments"
    new = command("new", text, output=False, settings=False)
    new.add_argument("model", metavar="MODEL", help="a built-in model or an MJCF file")
    _selection(new)
    _file(new, "the problem file to write; it must not be there (default: print it)")

    export = command("export", "write a plan, or a model in C, for other programs", output=False)
    text = "a saved plan's folder, a built-in problem or a TOML file; for c also a built-in model or an MJCF file"
    export.add_argument("plan", metavar="PLAN-or-MODEL", help=text)
    text = f"one of {', '.join(f'{name} ({what})' for name, what in (FORMATS | FOLDER_FORMATS).items())}"
    export.add_argument("--to", required=True, metavar="FORMAT", help=text)
    _file(export, "the file to write; it must not be there; for c a folder", required=True)
    text = "for ros, and for a model in c: the output joints as coordinates (default: the independent joints)"
    export.add_argument("--joints", metavar="A,B", help=text)
    text = f"for c: the law of a plan, one of {', '.join(C_TRACKERS)} (default: %(default)s)"
    export.add_argument("--tracker", default="pd+ff", metavar="NAME", help=text)
    text = "time between samples (default: ten samples in every interval of the plan's mesh)"
    export.add_argument("--every-s", type=float, metavar="T", help=text)
    _anyway(export)
    _selection(export)

    text = "print the JSON Schema of problem files, for completion in editors"
    schema = command("schema", text, output=False, settings=False)
    schema.add_argument("file", nargs="?", default="problem", metavar="KIND", help="problem or batch (default: %(default)s)")
    schema.add_argument("-o", "--output", metavar="FILE", help="write it into this file")

    completion = command("completion", "print a shell's completion script", output=False, settings=False)
    text = f"{', '.join(SHELLS)}; e.g. linkplan completion bash > ~/.local/share/bash-completion/completions/linkplan"
    completion.add_argument("shell", metavar="SHELL", help=text)
    return parser


def _loop(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL-or-PROBLEM", help="a built-in model or problem, or an MJCF or TOML file")
    parser.add_argument("--tracker", default="pd", metavar="LAW", help="pd, pd+ff or lqr (default: %(default)s)")
    parser.add_argument("--period-s", type=float, metavar="T", help="control period [s] (default: the problem's)")
    parser.add_argument("--delay-periods", type=float, metavar="N", help="computing delay in control periods (default: 0)")
    _at(parser, "a pose to analyse; may be given again (default: over the motion or the reach)")
    _selection(parser)


def _selection(parser: argparse.ArgumentParser) -> None:
    text = "of a larger robot, read only these bodies or joints (commas between names), what hangs on them and their loops"
    parser.add_argument("--keep", metavar="NAMES", help=text)
    text = "lock what lies between the world and the kept bodies, and a base that no actuator moves"
    parser.add_argument("--fix-base", action="store_true", help=text)
    text = "lock a joint at an angle [deg], or a slide at a position [m]; may be given again"
    parser.add_argument("--lock", action="append", default=[], metavar="JOINT=VALUE", help=text)
    parser.add_argument("--keyframe", metavar="NAME", help='the keyframe of the home pose (default: "home")')
    text = "joints that get a motor within their effort limits (commas between names), where the model has no actuators"
    parser.add_argument("--drive", metavar="NAMES", help=text)


def _transfer(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", metavar="MODEL-or-PROBLEM", help="a built-in model or problem, or an MJCF or TOML file")
    _selection(parser)
    parser.add_argument(
        "--joints", required=True, metavar="A,B", help="output joints, one to three, with commas between them"
    )
    text = "interpolation error allowed, as a share of each quantity's largest size (default: %(default)s)"
    parser.add_argument("--tolerance", type=float, default=1e-3, metavar="E", help=text)
    text = "the table's range of an output joint, JOINT=LOW:HIGH in degrees (default: its whole reach); may be given again"
    parser.add_argument("--range", action="append", default=[], metavar="RANGE", help=text)
    text = "top speeds of the motors [rad/s or m/s], one for all or with commas (default: the problem's motors)"
    parser.add_argument("--motor-speed", metavar="W", help=text)
    for side, other in (("joint", "motors"), ("motor", "joints")):
        for letter, what, unit in (("kp", "stiffness", "N.m/rad"), ("kd", "damping", "N.m.s/rad")):
            text = f"{what} of the {side}s [{unit}] to carry to the {other}, one for all or with commas"
            parser.add_argument(f"--{side}-{letter}", metavar="K", help=text)
    text = "a plan of the same model, along which the errors of models without loops are stated"
    parser.add_argument("--along", metavar="PLAN", help=text)
    _parquet(parser, "table.csv and inverse.csv")


def _tracker(parser: argparse.ArgumentParser) -> None:
    text = "pd, pd+ff, lqr, lqi, gs-pd+ff, ct or mpc; your own as module:object (default: %(default)s)"
    parser.add_argument("--tracker", default="pd+ff", metavar="NAME", help=text)


def _experiment(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("plan", metavar="PROBLEM-or-PLAN", help="a built-in problem, a TOML file or a saved plan's folder")
    _anyway(parser)
    parser.add_argument("--samples", type=int, default=200, metavar="N", help="machines (default: %(default)s)")
    text = "names with commas between them, your own as module:object; or all (default: %(default)s)"
    parser.add_argument("--trackers", default="pd,pd+ff,lqr", metavar="NAMES", help=text)
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers (default: %(default)s)")
    text = "distribution of samples: latin-hypercube or grid; sensitivity: one-at-a-time, morris or sobol"
    text += " (default: %(default)s)"
    parser.add_argument("--design", default="latin-hypercube", metavar="DESIGN", help=text)
    parser.add_argument("--levels", type=int, default=3, metavar="N", help="of a grid (default: %(default)s)")
    text = "success: no hinge is farther from the path (default: %(default)s)"
    parser.add_argument("--tube-deg", type=float, default=1.0, metavar="A", help=text)
    text = "success: no slide is farther from the path (default: %(default)s)"
    parser.add_argument("--tube-m", type=float, default=0.01, metavar="L", help=text)
    _engine(parser)
    text = "of the simulator for each worker (default: an equal share of the cores)"
    parser.add_argument("--threads", type=int, default=0, metavar="N", help=text)


def _engine(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers", type=int, metavar="N", help="processes of this machine that share the work (default: 1)"
    )
    text = "share the work among the workers of the Dask scheduler at this address, such as tcp://head:8786"
    parser.add_argument("--cluster", metavar="ADDRESS", help=text)


def _parquet(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument("--parquet", action="store_true", help=f"with -o: the table of {what} as Parquet too")


def _file(parser: argparse.ArgumentParser, text: str, *, required: bool = False) -> None:
    parser.add_argument("-o", "--output", metavar="FILE", required=required, help=text)


def _render(render: argparse.ArgumentParser) -> None:
    render.add_argument("plan", metavar="PLAN", help="a saved plan's folder, a built-in problem or a TOML file")
    text = "the file to write, whole: .mp4, .gif or .png; one that linkplan did not write is left alone"
    render.add_argument("-o", "--output", metavar="FILE", required=True, help=text)
    _anyway(render)
    _tracker(render)
    render.add_argument("--slow", type=float, metavar="X", help="times slower than real (default: to last some 4 s)")
    render.add_argument("--fps", type=float, default=25.0, metavar="N", help="frames a second (default: %(default)s)")
    render.add_argument("--size", default="800x600", metavar="WxH", help="of the picture in pixels (default: %(default)s)")
    text = "a camera of the model by its name, or AZIMUTH/ELEVATION in degrees (default: the mechanism's own side)"
    render.add_argument("--camera", metavar="VIEW", help=text)
    text = "play a film forwards and backwards, so that it repeats without a jump"
    render.add_argument("--there-and-back", action="store_true", help=text)
    text = "a picture of one instant, with the plan's ghost (default: several instants in one picture)"
    render.add_argument("--at-s", type=float, metavar="T", help=text)
    text = "number of instants in one picture (default: %(default)s)"
    render.add_argument("--instants", type=int, default=7, metavar="N", help=text)


def _anyway(parser: argparse.ArgumentParser) -> None:
    text = "run a saved plan that does not pass its certificate, with a note and exit code 1"
    parser.add_argument("--anyway", action="store_true", help=text)


def _at(parser: argparse.ArgumentParser, text: str) -> None:
    text += "; degrees, metres for a slide"
    parser.add_argument("--at-deg", action="append", default=[], metavar="JOINT=ANGLE", help=text)


def _mismatch(parser: argparse.ArgumentParser, mass_factor: float, delay: float) -> None:
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
        type=float,
        default=delay,
        metavar="N",
        help="mismatch: further control periods of delay (default: %(default)s)",
    )
