"""Commands ended at random moments: `python -m tests.bench.kills N SEED [NAME ...]` ends each N times in each of four ways.

The ways are kill -9, SIGTERM and Ctrl-C at a random one of the things that the command does to its folders, and a disk
that is full from there on. What must hold: after the next run the earlier result or the new one is there whole, without
litter; the exit code is that of the way, and what is said of the result is true.
"""

import errno
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from linkplan.planner.files.folders import check_target
from linkplan.planner.files.manifest import MANIFEST

WAYS = ("kill", "term", "int", "full")
SIGNALS = {"kill": signal.SIGKILL, "term": signal.SIGTERM, "int": signal.SIGINT}
LEGAL = {"kill": -signal.SIGKILL, "term": 143, "int": 130, "full": 2}
# Beyond this a command hangs [s].
LIMIT_S = 300.0
# What a command does to its folders, as Python tells it before it is done.
_EVENTS = {"open", "os.mkdir", "os.rename", "os.link", "os.remove", "os.rmdir", "os.chmod", "os.scandir", "os.listdir"}
_NEEDS_ROOM = {"open", "os.mkdir", "os.link"}
BATCH = """problem = "knee-reach"
[[case]]
name = "near"
set = ["motion.goal_deg.O=20"]
[[case]]
name = "far"
set = ["motion.goal_deg.O=25"]
"""


class Outcome(NamedTuple):
    """What became of a command: way, moment, exit code, whether the result is the new one, and what was wrong."""

    command: str
    way: str
    moment: int
    code: int | None
    new: bool
    wrong: str


class Command(NamedTuple):
    """A command line that writes into `out`, and the name of its record.

    One that `resumes` leaves its parts beside the result, and goes on from them.
    """

    words: tuple[str, ...]
    record: str
    resumes: bool = False


COMMANDS = {
    "plan": Command(("plan", "knee-reach", "-o", "out"), "plan.json"),
    "batch": Command(("batch", "batch.toml", "-o", "out"), "batch.json", resumes=True),
}


def forked(root: Path, words: tuple[str, ...], before: Callable[[], None]) -> tuple[int | None, str]:
    """Return exit code and stderr of a command in a child of this process; None where it hangs."""
    from linkplan.cli.main import main as program

    child = os.fork()
    if child == 0:
        code = 70
        try:
            os.chdir(root)
            os.environ["LINKPLAN_CACHE"] = str(root / "cache")
            for number, name in ((1, "../stdout"), (2, "../stderr")):
                os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
            warnings.simplefilter("ignore")
            sys.argv = ["linkplan", *words]
            before()
            code = program(list(words))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    until, status = time.monotonic() + LIMIT_S, None
    while time.monotonic() < until:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        time.sleep(0.01)
    else:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None, ""
    return os.waitstatus_to_exitcode(status), (root.parent / "stderr").read_text(encoding="utf-8", errors="replace")


def counted(root: Path, act: Callable[[int, str], None]) -> None:
    """Call a function before each thing that this process does to a folder, with its number and its kind."""
    number, inside, busy = 0, str(root), False

    def hook(event: str, arguments: tuple) -> None:
        nonlocal number, busy
        if busy or event not in _EVENTS or not isinstance(arguments[0], str | bytes | os.PathLike):
            return
        busy = True
        path = os.path.abspath(os.fsdecode(arguments[0]))
        busy = False
        if not path.startswith(inside) or (event == "open" and not arguments[2] & (os.O_WRONLY | os.O_RDWR)):
            return
        number += 1
        act(number, event)

    sys.addaudithook(hook)


def ending(root: Path, way: str, moment: int) -> Callable[[], None]:
    """Return what prepares a command to be ended in a way at a moment."""

    def act(number: int, event: str) -> None:
        if way in SIGNALS and number == moment:
            os.kill(os.getpid(), SIGNALS[way])
        if way == "full" and number >= moment and event in _NEEDS_ROOM:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    return lambda: counted(root, act)


def moments(root: Path, words: tuple[str, ...]) -> int:
    """Return how many things a command does to its folders, by running it."""
    with (root.parent / "tally").open("w+b", buffering=0) as tally:
        code, said = forked(root, words, lambda: counted(root, lambda *_: tally.write(b"1")))
        if code != 0:
            raise RuntimeError(f"{words} ends with {code}: {said}")
        return tally.tell()


def content(folder: Path) -> dict[str, bytes]:
    """Return every file below a folder with its bytes."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def identity(files: dict[str, bytes]) -> str:
    """Return which writing a result is of; nothing where there is none."""
    return json.loads(files[MANIFEST])["identity"] if MANIFEST in files else ""


def faults(out: Path, before: dict[str, bytes], record: str) -> list[str]:
    """Return what is wrong with a result: it is to be the earlier one or a new one, whole."""
    if not before and not out.exists():
        return []
    if not out.is_dir():
        return ["the result is gone"]
    after = content(out)
    if identity(after) == identity(before):
        return [f"{name} has changed" for name in before if after.get(name) != before[name]]
    listed = {*json.loads(after[MANIFEST])["files"], MANIFEST, record}
    return [f"{name} is missing" for name in listed - set(after)] + [f"{name} is litter" for name in set(after) - listed]


def judged(
    root: Path, way: str, code: int | None, said: str, before: dict[str, bytes], command: Command
) -> tuple[bool, str]:
    """Return whether a result is the new one, and what is wrong after a command was ended."""
    out = root / "out"
    # A process that is killed between two names leaves the earlier result under another one for the next run.
    wrong = [] if way == "kill" else faults(out, before, command.record)
    new = out.is_dir() and identity(content(out)) != identity(before)
    if code not in (LEGAL[way], 0) or (code == 0 and not new):
        wrong.append(f"exit code {code}, {said[-300:]}")
    if "Traceback" in said or "internal error of linkplan" in said:
        wrong.append(f"a traceback: {said[-600:]}")
    if "interrupted" in said:
        unfinished = (root / "out.unfinished").is_dir()
        parts = "run the same command again" if unfinished else "nothing was written"
        true = f"the complete result is in '{out.name}'" if new else parts
        wrong += [] if true in said else [f"untrue: {said[-300:]}"]
    check_target(out, command.record)  # what the next run begins with
    wrong += faults(out, before, command.record)
    # Killed between the result and the removal of its parts, the next run removes them.
    parts = {"out.unfinished"} if command.resumes and (way == "kill" or not new) else set()
    litter = {p.name for p in root.iterdir()} - parts - {"out", "cache", "batch.toml", "other.txt"}
    wrong += [f"{name} is litter" for name in litter]
    if (root / "other.txt").read_text(encoding="utf-8") != "beside it":
        wrong.append("the file beside it is lost")
    return new, "; ".join(dict.fromkeys(wrong))


def prepared(root: Path, earlier: Path | None) -> dict[str, bytes]:
    """Fill a new folder for a command, with an earlier result or without, and return what is in that."""
    root.mkdir()
    (root / "other.txt").write_text("beside it", encoding="utf-8")
    (root / "batch.toml").write_text(BATCH, encoding="utf-8")
    if earlier is None:
        return {}
    shutil.copytree(earlier, root / "out")
    return content(root / "out")


def ended(name: str, ways: tuple[str, ...], count: int, seed: int) -> list[Outcome]:
    """Return what became of a command that was ended `count` times in each of some ways."""
    rng, command, found = random.Random(f"{seed}/{name}"), COMMANDS[name], []
    with tempfile.TemporaryDirectory() as place:
        base = Path(place).resolve()
        prepared(base / "run", None)
        last = moments(base / "run", command.words)
        earlier = base / "earlier"
        shutil.move(base / "run" / "out", earlier)
        shutil.rmtree(base / "run")
        for number in range(count * len(ways)):
            way, root = ways[number % len(ways)], base / "run"
            before = prepared(root, earlier if rng.random() < 0.8 else None)
            # With an earlier result there is more to do than without.
            moment = rng.randint(1, last + 10)
            code, said = forked(root, command.words, ending(root, way, moment))
            new, wrong = judged(root, way, code, said, before, command)
            found.append(Outcome(name, way, moment, code, new, wrong))
            if wrong:
                print(found[-1], flush=True)
            shutil.rmtree(root, ignore_errors=True)
    return found


def main(count: int, seed: int, names: list[str]) -> int:
    """End each command N times in each way and print what came of it; 1 where something was wrong."""
    wrong = 0
    for name in names or COMMANDS:
        found = ended(name, WAYS, count, seed)
        for way in WAYS:
            of = [outcome for outcome in found if outcome.way == way]
            codes = dict(sorted(Counter(str(outcome.code) for outcome in of).items()))
            bad, new = sum(bool(o.wrong) for o in of), sum(o.new for o in of)
            print(f"{name}, {way}: {len(of)} times, exit codes {codes}, the new result {new}, wrong {bad}", flush=True)
            wrong += bad
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
