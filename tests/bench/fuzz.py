"""Hostile input by the thousand: `python -m tests.bench.fuzz N SEED` mutates problem files, models, plan folders and command
lines, and runs the command line on each.

What must hold: no traceback, an exit code of 0, 1, 2 or 130, an answer within 30 s, and no more than 2 GB of address space
(beyond what the libraries map when they are loaded). Cases run in a child process, many in one; a case that ends or hangs it
is named, and another child goes on after it.
"""

import contextlib
import io
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.bench.fuzz_inputs import FEW, KINDS, case_of

LEGAL = (0, 1, 2, 130)
LIMIT_S, LIMIT_BYTES = 30, 2_000_000_000
# So many cases in one process: 400 map 3 GB (a renderer's and writers' threads, each with room of its own; holes that big
# arrays leave), of which 0.4 GB are resident once the holes are given back and 0.04 GB are functions kept for mechanisms.
_IN_ONE = 200


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Outcome:
    """What became of a case: its number, kind, exit code (None where the child died), seconds, and what was wrong."""

    number: int
    kind: str
    code: int | None
    seconds: float
    wrong: str


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
    from linkplan.studies.cli.main import main as program

    warnings.simplefilter("ignore")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        program(["experiment", str(plan), *FEW])  # maps a simulator's threads and what tables are written with
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
        child = context.Process(target=_child, args=(waiting[:_IN_ONE], seed, plan, theirs))
        child.start()
        theirs.close()
        current = waiting[0]
        try:
            while True:
                number, outcome = ours.recv()
                if number is None:
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
        print(f"{len(found)} of {len(numbers)}", file=sys.stderr, flush=True)
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
