"""Hostile input by the thousand: `python -m tests.bench.fuzz N SEED` mutates problem files, models, plan folders and command
lines, and runs the command line on each.

What must hold: no traceback, an exit code of 0, 1, 2 or 130, an answer within 30 s, and no more than 2 GB of address space
beyond what the libraries map when they are loaded. Many cases run in one child process. One that ends or hangs it is named,
and another child goes on after it.
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
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

KINDS = ("toml", "mjcf", "folder", "line")
LEGAL = (0, 1, 2, 130)
LIMIT_S, LIMIT_BYTES = 30, 2_000_000_000
# So many cases in one process: a renderer's and writers' threads each map room of their own, which is not given back.
IN_ONE = 200
PROBLEMS = ("knee-reach", "knee-sine", "slider-crank-turn", "cart-pole-swing-up", "knee-linear-reach")
MODELS = ("optimus-knee", "slider-crank", "cart-pole", "five-bar", "parallel-gripper")
# Values that have broken something, somewhere.
NUMBERS = ("0", "-0", "-1", "1e-300", "1e300", "inf", "-inf", "nan", "1e6", "1e9", "1e-9", "9" * 5000, "2147483648", "0.5")
WORDS = ('""', '"$x^$"', '"=1+1"', '"\\u001b[31m"', '"../.."', '"/dev/zero"', "true", "1979-05-27", "[]", "{}",
         "[[1], [2]]", "{ O = 1 }", '["O"]', "[nan]", "[inf, -inf]", "[" * 3000)  # fmt: skip
SETTINGS = ("O=1,5", "O=nan", "=", "tracking.kp=1e300", "tracking.period_s=1e9", "mesh.intervals=1e9",
            "imperfections.push_start_s=1e9", "robust.payload_factor=[0,1e9]", "mpc", "a:b", "a.mp4", "a/b/c", "nan/inf",
            "99999x99999", "-1x", "pd", "none", "a.b=[" + "[" * 3000, "/dev/full", "\udcff", "")  # fmt: skip
EXTRAS = ('<option timestep="{}"/>', '<size memory="{}G"/>', '<size nuserdata="{}"/>', '<include file="/dev/zero"/>',
          '<asset><hfield name="h" nrow="{}" ncol="{}" size="1 1 1 1"/></asset>', '<include file="pipe.xml"/>',
          '<worldbody><replicate count="{}"><site pos="1 0 0"/></replicate></worldbody>', '<option gravity="0 0 {}"/>',
          '<default><joint armature="{}" damping="{}"/></default>', '<default><motor gear="{}"/></default>',
          '<include file="a.mjcf"/>', '<asset><mesh name="m" file="/dev/zero"/></asset>',
          '<asset><mesh name="m" file="pipe.xml"/></asset>', '<sensor><user name="u" dim="{}"/></sensor>',
          '<extension><plugin plugin="no.such"/></extension>')  # fmt: skip
COMMANDS = ("check", "track", "bode", "tune", "list", "plan", "compare", "view", "experiment", "export", "new", "render",
            "report", "schema", "batch", "completion", "chek", "")  # fmt: skip
# What runs machines in MuJoCo or draws them, few of them and small.
SMALL = {
    "experiment": ["--samples", "2", "--threads", "1"], "render": ["--size-px", "64x64", "--instants", "1", "-o", "out.png"],
    "export": ["--to", "csv", "-o", "out.x"], "bode": ["--no-measure"],
    "plan": ["--set", "mesh.intervals=10", "--set", "solver.max_time_s=5"],
}  # fmt: skip


class Outcome(NamedTuple):
    """What became of a case: its number, kind, exit code (None where the child died), and what was wrong."""

    number: int
    kind: str
    code: int | None
    wrong: str


def damaged(rng: random.Random, content: bytes) -> bytes:
    """Return bytes with one to four random damages."""
    data = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(1, len(data)))
        inserted = rng.choice(
            [b"\xff\xfe", b"\0", b"\xe9", b"\x1b[2J", b"$x^$", b"<", b'"', b"\n[", b"9" * 5000, b"[" * 5000]
        )
        end = rng.choice([at, at, at + 1, at + 40, len(data)])
        data[at:end] = rng.choice([inserted, data[at : at + 200], bytes([rng.randrange(256)]), b""])
    return bytes(data)


def mutated(rng: random.Random, text: str, pattern: str, values: tuple[str, ...]) -> bytes:
    """Return a text whose values, the pattern's last groups, are replaced or have a number replaced; or damaged bytes."""
    if rng.random() < 0.25:
        return damaged(rng, text.encode())
    for _ in range(rng.randint(1, 3)):
        one = rng.choice(list(re.finditer(pattern, text, flags=re.MULTILINE)))
        number = rng.choice(NUMBERS)
        inner = re.sub(r"-?\d+(\.\d+)?", lambda _, number=number: number, one[1], count=1)
        text = text[: one.start(1)] + rng.choice([inner, inner, number, rng.choice(values)]) + text[one.end(1) :]
    return text.encode("utf-8", "replace")


def mutated_toml(rng: random.Random) -> bytes:
    """Return a problem file with values replaced and a key of any section added."""
    from linkplan.planner.files.tables import built_in_text, inline
    from linkplan.planner.problem.keys.key_table import key_table

    text = built_in_text(rng.choice(PROBLEMS))
    row = rng.choice([row for row in key_table() if row.section])
    head, added = f"[{row.section}]", f"{row.name} = {'1.0' if row.default is None else inline(row.default)}\n"
    text = text.replace(head, f"{head}\n{added}") if head in text else f"{text}\n{head}\n{added}"
    return mutated(rng, text, r"^[\w.]+ = (.+)$", WORDS)


def mutated_mjcf(rng: random.Random) -> bytes:
    """Return a model with attributes replaced and, often, an element added."""
    from linkplan.models.library import built_in_text

    text = built_in_text(rng.choice(MODELS))
    if rng.random() < 0.4:
        text = text.replace("</mujoco>", rng.choice(EXTRAS).replace("{}", rng.choice(NUMBERS)) + "</mujoco>")
    return mutated(rng, text, r'\w="([^"]*)"', ("", "&#27;[31m", "$x^$", "\u00e9", "x" * 300, "0 0 0", "inf inf inf"))


def mutated_folder(rng: random.Random, plan: Path, folder: Path) -> None:
    """Write a plan's folder with its bytes, or a value of its record, changed."""
    shutil.copytree(plan, folder)
    if rng.random() < 0.5:
        path = folder / rng.choice(["plan.json", "trajectory.npz"])
        path.write_bytes(damaged(rng, path.read_bytes()))
        return
    said = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    node = rng.choice([said, said["problem"]])
    node[rng.choice(list(node))] = rng.choice([None, -1, 1e300, 10**400, "$x^$", [], {}, {"a": 1}, True, "failed"])
    (folder / "plan.json").write_text(json.dumps(said), encoding="utf-8")


def command_line(rng: random.Random, plan: Path) -> list[str]:
    """Return a command line with options and values drawn at random."""
    command = rng.choice(COMMANDS)
    of = [str(plan), str(plan / "plan.json"), "/", "/dev/zero", "", "\udce9", "x" * 5000, *MODELS, *PROBLEMS]
    line = [command, rng.choice([str(plan), rng.choice(of)])]
    for _ in range(rng.randint(0, 3)):
        option = rng.choice(["--at-deg", "--set", "--kp", "--period-s", "--frequency-hz", "--trackers", "--json",
                             "--anyway", "--fps", "--size-px", "--seed", "--samples", "--every-s", "-o"])  # fmt: skip
        line += [option] if option in ("--json", "--anyway") else [option, rng.choice([*NUMBERS, *SETTINGS])]
    return line + SMALL.get(command, [])


def case_of(number: int, seed: int, plan: Path, folder: Path) -> tuple[str, list[str]]:
    """Return the kind and the command line of a case, its files written into an empty folder."""
    rng, kind = random.Random(f"{seed}/{number}"), KINDS[number % len(KINDS)]
    os.mkfifo(folder / "pipe.xml")
    if kind == "line":
        return kind, command_line(rng, plan)
    if kind == "folder":
        mutated_folder(rng, plan, folder / "a.folder")
    else:
        (folder / f"a.{kind}").write_bytes(mutated_toml(rng) if kind == "toml" else mutated_mjcf(rng))
    commands = {"toml": ("check", "check", "plan", "track", "experiment"), "mjcf": ("check", "check", "new"),
                "folder": ("track", "track", "export", "report", "experiment", "render")}  # fmt: skip
    command = rng.choice(commands[kind])
    return kind, [command, str(folder / f"a.{kind}"), *SMALL.get(command, [])]


def run_case(number: int, seed: int, plan: Path) -> Outcome:
    """Return what became of one case, run in this process."""
    from linkplan.cli import main as program

    caught: list[str] = []
    program.unforeseen = lambda command, error: caught.append(f"{command}: {error!r}") or 2
    with tempfile.TemporaryDirectory() as place:
        kind, line = case_of(number, seed, plan, Path(place))
        os.chdir(place)
        out, err, code = io.StringIO(), io.StringIO(), None
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = program.main(line)
        except BaseException as error:  # what the program lets through is what is looked for
            caught.append(repr(error))
        finally:
            os.chdir("/")
    said = out.getvalue() + err.getvalue()
    wrong = caught[:1] + ["a traceback"] * ("Traceback" in said) + ["a control character"] * ("\x1b" in said)
    wrong += [] if code in LEGAL else [f"exit code {code}"]
    return Outcome(number, kind, code, f"{wrong[0]}, of {line}" if wrong else "")


def _child(numbers: list[int], seed: int, plan: Path, pipe) -> None:
    import warnings

    from linkplan.cli.main import main as program

    warnings.simplefilter("ignore")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        program(["experiment", str(plan), *SMALL["experiment"]])  # maps a simulator's threads and what writes tables
    mapped = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + LIMIT_BYTES, mapped + LIMIT_BYTES))
    for number in numbers:
        pipe.send(number)
        # Their default actions end the process, in the midst of compiled code too: of processor time, and of waiting.
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
        signal.alarm(10 * LIMIT_S)
        pipe.send(run_case(number, seed, plan))
    signal.alarm(0)
    signal.setitimer(signal.ITIMER_PROF, 0)


def fuzz(numbers: list[int], seed: int, plan: Path) -> list[Outcome]:
    """Return what became of cases, by their numbers; `plan` is a saved plan's folder."""
    context, found, waiting = multiprocessing.get_context("spawn"), [], list(numbers)
    while waiting:
        ours, theirs = context.Pipe(duplex=False)
        child = context.Process(target=_child, args=(waiting[:IN_ONE], seed, plan, theirs))
        child.start()
        theirs.close()
        begun = waiting[0]
        with contextlib.suppress(EOFError):
            while True:
                said = ours.recv()
                if isinstance(said, Outcome):
                    found.append(said)
                else:
                    begun = said
        child.join()
        if child.exitcode and all(outcome.number != begun for outcome in found):
            why = f"ended by {child.exitcode}, or no answer within {LIMIT_S} s"
            found.append(Outcome(begun, KINDS[begun % len(KINDS)], None, why))
        waiting = [number for number in waiting if number not in {outcome.number for outcome in found}]
        print(f"{len(found)} of {len(numbers)}", file=sys.stderr, flush=True)
    return found


def main() -> int:
    """Run N cases of a seed and print what came of them; 1 where something was wrong."""
    from linkplan.cli.main import main as program

    with tempfile.TemporaryDirectory() as place:
        plan = Path(place) / "plan"
        with contextlib.redirect_stdout(io.StringIO()):
            if program(["plan", "knee-reach", "-o", str(plan)]):
                return 1
        found = fuzz(list(range(int(sys.argv[1]))), int(sys.argv[2]), plan)
    wrong = [outcome for outcome in found if outcome.wrong]
    for kind in KINDS:
        codes = Counter(str(outcome.code) for outcome in found if outcome.kind == kind)
        print(f"{kind}: exit codes {dict(sorted(codes.items()))}")
    print(*wrong, f"{len(found)} cases, wrong {len(wrong)}", sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
