"""Hostile input by the thousand: `python -m tests.bench.fuzz N SEED` mutates problem files, models, plan folders and command
lines, and runs the command line on each.

What must hold: no traceback, an exit code of 0, 1, 2 or 130, an answer within 30 s, and no more than 2 GB of address space
(beyond what the libraries map when they are loaded). Cases run in a child process, many in one; a case that ends or hangs it
is named, and another child goes on after it.
"""

import contextlib
import io
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

KINDS = ("toml", "mjcf", "folder", "line")
LEGAL = (0, 1, 2, 130)
LIMIT_S, LIMIT_BYTES = 30, 2_000_000_000
PROBLEMS = ("knee-reach", "knee-sine", "slider-crank-turn", "cart-pole-swing-up", "knee-linear-reach")
MODELS = ("optimus-knee", "slider-crank", "cart-pole", "five-bar", "parallel-gripper")
# Values that have broken something, somewhere.
NUMBERS = (
    "0",
    "-0",
    "-1",
    "1e-300",
    "1e300",
    "-1e300",
    "inf",
    "-inf",
    "nan",
    "1e6",
    "1e9",
    "1e-9",
    "9" * 5000,
    "2147483648",
    "0.5",
    "3",
)
WORDS = ('""', '"none"', '"$x^$"', '"=1+1"', '"\\u001b[31m"', '"../.."', '"/dev/zero"', "true", "1979-05-27", "[]", "{}",
         "[1, 2]", "[[1], [2]]", "{ O = 1 }", '["O"]', "[nan]", "[inf, -inf]", "[" * 3000)  # fmt: skip


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Outcome:
    """What became of a case: its number, kind, exit code (None where the child died), seconds, and what was wrong."""

    number: int
    kind: str
    code: int | None
    seconds: float
    wrong: str


def damaged(rng: random.Random, content: bytes) -> bytes:
    """Return bytes with one to four random damages."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(1, len(data)))
        what = rng.randrange(6)
        if what == 0:
            data[at : at + 1] = bytes([rng.randrange(256)])
        elif what == 1:
            del data[at : at + rng.randint(1, 40)]
        elif what == 2:
            data[at:at] = rng.choice(
                [b"\xff\xfe", b"\0", b"\xe9", b"\x1b[2J", b"$x^$", b"\xed\xa0\x80", b"<", b'"', b"\n[", b"="]
            )
        elif what == 3:
            del data[at:]
        elif what == 4:
            data[at:at] = data[at : at + rng.randint(1, 200)]
        else:
            data[at:at] = rng.choice([b"9" * 5000, b"[" * 5000, b"a" * 100_000])
    return bytes(data)


def mutated_toml(rng: random.Random) -> bytes:
    """Return a problem file with values of keys replaced, keys added, or bytes damaged."""
    from linkplan.planner.files.tables import built_in_text
    from linkplan.planner.files.toml_text import inline
    from linkplan.planner.keys.reading import KEYS

    text = built_in_text(rng.choice(PROBLEMS))
    if rng.random() < 0.25:
        return damaged(rng, text.encode())
    tables = tomllib.loads(text)
    lines: dict[str, dict[str, str]] = {"mesh": {"intervals": "10"}, "solver": {"max_time_s": "5.0"}}
    for section, content in tables.items():
        if isinstance(content, dict):
            lines.setdefault(section, {}).update({key: inline(value) for key, value in content.items()})
    for _ in range(rng.randint(1, 3)):
        section = rng.choice(list(KEYS))
        keys = KEYS[section] or ("act_O",)
        key = rng.choice(list(lines[section]) if rng.random() < 0.7 and lines.get(section) else keys)
        before = lines.setdefault(section, {}).get(key, "{ O = 1.0 }")
        number = rng.choice(NUMBERS)
        inner = re.sub(r"-?\d+(\.\d+)?", lambda _, number=number: number, before, count=1)
        lines[section][key] = rng.choice([number, rng.choice(WORDS), inner, inner])
    return "\n".join(f"[{s}]\n" + "\n".join(f"{k} = {v}" for k, v in keys.items()) for s, keys in lines.items()).encode()


def mutated_mjcf(rng: random.Random) -> bytes:
    """Return a model with attributes replaced or added, or bytes damaged."""
    from linkplan.models.catalogue import built_in_text

    text = built_in_text(rng.choice(MODELS))
    if rng.random() < 0.25:
        return damaged(rng, text.encode())
    for _ in range(rng.randint(1, 3)):
        found = list(re.finditer(r'(\w+)="([^"]*)"', text))
        one = rng.choice(found)
        number = rng.choice([*NUMBERS, "0 0 0", "1e300 1e300", "inf inf inf"])
        value = re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", lambda _, number=number: number, one[2], count=rng.randint(0, 1))
        value = rng.choice([value, value, number, "", "&#27;[31m", "$x^$", "=cmd", "\u00e9", "x" * 300])
        text = text[: one.start(2)] + value + text[one.end(2) :]
        if rng.random() < 0.4:
            extra = rng.choice([
                '<option timestep="{}"/>', '<compiler settotalmass="{}"/>', '<size memory="{}G"/>', '<size nuserdata="{}"/>',
                '<asset><hfield name="h" nrow="{0}" ncol="{0}" size="1 1 1 1"/></asset>', '<include file="/dev/zero"/>',
                '<include file="pipe.xml"/>', '<option gravity="0 0 {}"/>', '<option><flag gravity="disable"/></option>',
                '<worldbody><replicate count="{}"><site pos="1 0 0"/></replicate></worldbody>',
                '<asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 1"/></asset>'
                '<worldbody><geom type="hfield" hfield="h"/></worldbody>',
                '<default><joint armature="{}"/></default>', '<default><geom solref="{} 1"/></default>',
                '<default><motor gear="{}"/></default>', '<default><joint damping="{}" frictionloss="{}"/></default>',
            ])  # fmt: skip
            extra = extra.replace("{0}", number).replace("{}", number)
            text = text.replace("</mujoco>", f"{extra}</mujoco>")
    content = text.encode("latin-1" if rng.random() < 0.05 else "utf-8", "replace")
    return damaged(rng, content) if rng.random() < 0.05 else content


def mutated_folder(rng: random.Random, plan: Path, folder: Path) -> None:
    """Write a plan's folder with its record, its arrays or its bytes changed."""
    import numpy as np

    shutil.copytree(plan, folder)
    what = rng.randrange(4)
    if what == 0:
        name = rng.choice(["plan.json", "trajectory.npz"])
        (folder / name).write_bytes(damaged(rng, (folder / name).read_bytes()))
    elif what == 1:
        said = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
        node = said if rng.random() < 0.5 else said["problem"][rng.choice(list(said["problem"]))]
        node = node if isinstance(node, dict) and node else said
        node[rng.choice(list(node))] = rng.choice(
            [None, -1, 1e300, 10**400, "x", "$x^$", [], {}, [1], {"a": 1}, True, "failed"]
        )
        (folder / "plan.json").write_text(json.dumps(said), encoding="utf-8")
    elif what == 2:
        with np.load(folder / "trajectory.npz") as stored:
            arrays = dict(stored)
        name = rng.choice(list(arrays))
        value = arrays[name]
        arrays[name] = rng.choice([
            value * rng.choice([0.0, 0.5, 1.001, -1.0, 1e10]) if value.dtype != bool else ~value, value.reshape(-1)[:1],
            value.astype(complex) if value.dtype != bool else value, np.array("x"), np.zeros((0, 3)),
            value.astype(np.float16),
        ])  # fmt: skip
        np.savez_compressed(folder / "trajectory.npz", **arrays)
    else:
        np.savez_compressed(folder / "trajectory.npz", breaks_s=np.zeros(8_500_000), position=np.zeros(3))


def command_line(rng: random.Random, plan: Path) -> list[str]:
    """Return a command line with options and values drawn at random."""
    command = rng.choice(["check", "check", "track", "bode", "tune", "list", "plan", "compare", "view", "chek", ""])
    line = [command] if command else []
    if command in ("track", "compare", "view"):
        line.append(str(plan))
    elif command not in ("list", ""):
        line.append(rng.choice([*MODELS, *PROBLEMS, "nothing", "/dev/zero", ".", "", "\udce9", "x" * 5000]))
    options = ["--at-deg", "--set", "--kp", "--kd", "--period-s", "--delay-periods", "--from-hz", "--to-hz", "--frequencies",
               "--amplitude-deg", "--measure", "--tracker", "--mass-factor", "--bandwidth-hz", "--phase-margin-deg",
               "--json", "--anyway", "--slow", "--seconds", "--version", "-o"]  # fmt: skip
    for option in rng.sample(options, rng.randint(0, 3)):
        line.append(option)
        if option not in ("--json", "--anyway", "--version"):
            values = [*NUMBERS, "O=1,5", "O=nan", "O=1,O=2", "=", "tracking.kp=1e300", "tracking.period_s=1e9",
                      "mesh.intervals=1e9", "tracking.duration_s=1e9", "motion.duration_s=1e6", "mechanism.independent=3",
                      "mechanism.home_deg.O=1e300",
                      "pd", "lqr", "none", "a.b=[" + "[" * 3000, "/dev/full", "\udcff", ""]  # fmt: skip
            line.append(rng.choice(values))
    if command == "bode":
        line += ["--measure", "none"]
    if command == "plan":
        line += ["--set", "mesh.intervals=10", "--set", "solver.max_time_s=5"]
    return line


def case_of(number: int, seed: int, plan: Path, folder: Path) -> tuple[str, list[str]]:
    """Return the kind and the command line of a case, its files written into an empty folder."""
    rng = random.Random(f"{seed}/{number}")
    kind = KINDS[number % len(KINDS)]
    os.mkfifo(folder / "pipe.xml")
    if kind == "toml":
        (folder / "a.toml").write_bytes(mutated_toml(rng))
        return kind, [rng.choice(["check", "check", "check", "plan"]), str(folder / "a.toml")]
    if kind == "mjcf":
        (folder / "a.xml").write_bytes(mutated_mjcf(rng))
        line = ["check", str(folder / "a.xml")]
        return kind, line + (["-o", str(folder / "out")] if rng.random() < 0.2 else [])
    if kind == "folder":
        mutated_folder(rng, plan, folder / "p")
        return kind, ["track", str(folder / "p"), *rng.choice([[], ["--anyway"]])]
    return kind, command_line(rng, plan)


def run_case(number: int, seed: int, plan: Path) -> tuple[str, int | None, str]:
    """Return kind, exit code and what was wrong of one case, run in this process."""
    from linkplan.studies.cli import main as program

    caught: list[str] = []

    def kept(command: str, error: BaseException) -> int:
        import traceback

        caught.append(f"{command}: " + " | ".join("".join(traceback.format_exception(error)).split("\n")[-6:]))
        return 2

    program.unforeseen = kept
    with tempfile.TemporaryDirectory() as place:
        kind, line = case_of(number, seed, plan, Path(place))
        os.chdir(place)
        out, err = io.StringIO(), io.StringIO()
        code = None
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = program.main(line)
        except BaseException as error:  # what the program lets through is what is looked for
            caught.append(f"{type(error).__name__}: {error}")
        finally:
            os.chdir("/")
    said = err.getvalue()
    wrong = caught[0] if caught else "a traceback" if "Traceback" in said else ""
    if not wrong and code not in LEGAL:
        wrong = f"exit code {code}"
    if not wrong and ("\x1b" in said or "\x1b" in out.getvalue()):
        wrong = "a control character on the terminal"
    return kind, code, wrong


def _child(numbers: list[int], seed: int, plan: Path, pipe) -> None:
    import warnings

    import matplotlib.figure  # noqa: F401
    import mujoco  # noqa: F401

    from linkplan.planner import planning  # noqa: F401

    warnings.simplefilter("ignore")
    mapped = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + LIMIT_BYTES, mapped + LIMIT_BYTES))
    for number in numbers:
        pipe.send((number, None))
        # Their default actions end the process, in the midst of compiled code too: of processor time, and of waiting.
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
        signal.alarm(3 * LIMIT_S)
        begin = time.monotonic()
        kind, code, wrong = run_case(number, seed, plan)
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0)
        outcome = Outcome(number=number, kind=kind, code=code, seconds=time.monotonic() - begin, wrong=wrong)
        pipe.send((number, outcome))
    pipe.send((None, None))


def fuzz(numbers: list[int], seed: int, plan: Path) -> list[Outcome]:
    """Return what became of cases, by their numbers; `plan` is a saved plan's folder."""
    context, found, waiting = multiprocessing.get_context("spawn"), [], list(numbers)
    while waiting:
        ours, theirs = context.Pipe(duplex=False)
        child = context.Process(target=_child, args=(waiting, seed, plan, theirs))
        child.start()
        theirs.close()
        current = waiting[0]
        try:
            while True:
                number, outcome = ours.recv()
                if number is None:
                    waiting = []
                    break
                current = number
                if outcome is not None:
                    found.append(outcome)
                    if outcome.wrong:
                        print(f"case {number}: {outcome}", flush=True)
                    waiting = waiting[waiting.index(number) + 1 :]
        except EOFError:
            child.join()
            why = (
                f"no answer within {LIMIT_S} s"
                if child.exitcode in (-signal.SIGALRM, -signal.SIGPROF)
                else f"ended by {child.exitcode}"
            )
            kind = KINDS[current % len(KINDS)]
            found.append(Outcome(number=current, kind=kind, code=None, seconds=float(LIMIT_S), wrong=why))
            print(f"case {current} ({kind}): {why}", flush=True)
            waiting = waiting[waiting.index(current) + 1 :]
        child.join()
    return found


def run_outside(numbers: list[int], seed: int, plan: Path) -> list[Outcome]:
    """Return what became of cases run as a user would, each in a process of its own."""
    found = []
    for number in numbers:
        with tempfile.TemporaryDirectory() as place:
            kind, line = case_of(number, seed, plan, Path(place))
            begin = time.monotonic()
            argv = [sys.executable, "-m", "linkplan", *line]
            if any("\0" in word for word in argv):
                continue
            try:
                done = subprocess.run(argv, cwd=place, capture_output=True, timeout=2 * LIMIT_S, check=False)
                code, said = done.returncode, done.stderr
            except subprocess.TimeoutExpired:
                code, said = None, b""
        wrong = "a traceback" if b"Traceback" in said else "" if code in LEGAL else f"exit code {code}"
        wrong = wrong or ("a fault of its own" if b"fault of linkplan's own" in said else "")
        found.append(Outcome(number=number, kind=kind, code=code, seconds=time.monotonic() - begin, wrong=wrong))
    return found


def main() -> int:
    """Run N cases of a seed and print what came of them; 1 where something was wrong."""
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    from linkplan.studies.cli.main import main as program

    with tempfile.TemporaryDirectory() as place:
        plan = Path(place) / "plan"
        with contextlib.redirect_stdout(io.StringIO()):
            if program(["plan", "knee-reach", "-o", str(plan)]):
                return 1
        found = fuzz(list(range(count)), seed, plan)
        found += run_outside(list(range(0, count, max(1, count // 20)))[:20], seed, plan)
    for kind in KINDS:
        of = [outcome for outcome in found if outcome.kind == kind]
        codes = dict(sorted(Counter(str(outcome.code) for outcome in of).items()))
        longest = max((outcome.seconds for outcome in of), default=0.0)
        print(
            f"{kind}: {len(of)} cases, exit codes {codes}, longest {longest:.1f} s, wrong {sum(bool(o.wrong) for o in of)}"
        )
    return 1 if any(outcome.wrong for outcome in found) else 0


if __name__ == "__main__":
    sys.exit(main())
