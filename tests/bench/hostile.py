"""Hostile surroundings, by hand: `python -m tests.bench.hostile [WORD ...]` runs each case of `hostile_cases` whose name has
one of the words in it (by default all), as a process of its own in a folder of its own; `-v` prints what was right too.

It wants Linux and root, for mounts and permissions. What must hold: an exit code that the case allows, no traceback, no
fault of linkplan's own, one line of refusal where the code is 2, an answer within 30 s, at most 2 GB resident, no file of
the folder changed that was there before, and no litter.
"""

import contextlib
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

LIMIT_S, LIMIT_BYTES = 30.0, 2_000_000_000
# Root without the right to overrule permissions.
_BOUND = ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner,-sys_resource,-sys_admin")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Case:
    """A command line among hostile surroundings.

    `files` are written first, then `make` is called with the folder; a word "planned" stands for a saved plan of the knee.
    `env` goes over the environment (None takes a variable away), `limits` are resource limits, `closed` are descriptors that
    are closed, `during` is called with the folder and the process's number once it runs, `after` says what is wrong with the
    folder in the end, `says` is to be found in what is said, `changes` are files that may change, `most_bytes` may be
    resident.
    """

    name: str
    words: tuple[str, ...]
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    make: Callable[[Path], None] | None = None
    env: Mapping[str, str | None] = field(default_factory=dict)
    limits: Mapping[int, int] = field(default_factory=dict)
    closed: tuple[int, ...] = ()
    during: Callable[[Path, int], None] | None = None
    after: Callable[[Path], str] | None = None
    codes: tuple[int, ...] = (2,)
    says: str = ""
    unprivileged: bool = False
    changes: tuple[str, ...] = ()
    lines: int = 1
    program: tuple[str, ...] = ("-m", "linkplan")
    stdout: str | None = None
    most_bytes: int = LIMIT_BYTES


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Outcome:
    """What became of a case: exit code, seconds, the largest resident size [bytes], what was said, and what was wrong."""

    name: str
    code: int | None
    seconds: float
    resident: int
    said: str
    wrong: str


def content(folder: Path) -> dict[str, bytes]:
    """Return every regular file below a folder that can be read, with its bytes; links are not followed."""
    found = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = Path(place) / name
            if path.is_file() and not path.is_symlink() and path.stat().st_size < 50_000_000:
                with contextlib.suppress(OSError):
                    found[str(path.relative_to(folder))] = path.read_bytes()
    return found


def run_case(case: Case, planned: Path, root: Path) -> Outcome:
    """Return what became of a case that is run in a new folder below `root`."""
    folder = root / "here"
    folder.mkdir()
    try:
        return _judged(case, planned, folder)
    finally:
        with contextlib.suppress(OSError):
            subprocess.run(["umount", "-q", str(folder / "mounted")], check=False, stderr=subprocess.DEVNULL)
        for place, names, _ in os.walk(folder):
            for name in names:
                with contextlib.suppress(OSError):
                    os.chmod(os.path.join(place, name), 0o755)
        shutil.rmtree(folder, ignore_errors=True)


def _judged(case: Case, planned: Path, folder: Path) -> Outcome:
    if any("planned" in word for word in case.words) or case.make is not None:
        shutil.copytree(planned, folder / "planned")
    for name, text in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    if case.make is not None:
        case.make(folder)
    before = content(folder)
    given = os.environ | {"LINKPLAN_CACHE": str(folder.parent / "cache"), "OMP_NUM_THREADS": "1", "HOME": str(folder.parent)}
    given = {key: value for key, value in {**given, **case.env}.items() if value is not None}

    def prepare() -> None:
        for number, most in case.limits.items():
            resource.setrlimit(number, (most, most))
        for number in case.closed:
            os.close(number)

    argv = [*(_BOUND if case.unprivileged else ()), sys.executable, *case.program, *case.words]
    begin = time.monotonic()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        target = out if case.stdout is None else open(case.stdout, "wb")  # noqa: SIM115
        process = subprocess.Popen(
            argv,
            cwd=folder,
            env=given,
            stdin=subprocess.DEVNULL,
            stdout=target,
            stderr=err,
            preexec_fn=prepare,
            start_new_session=True,
        )
        timer = threading.Timer(2 * LIMIT_S, os.kill, (process.pid, signal.SIGKILL))
        timer.start()
        if case.during is not None:
            case.during(folder, process.pid)
        _, status, used = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = code = os.waitstatus_to_exitcode(status)
        out.seek(0), err.seek(0)
        printed, said = out.read(), err.read().decode("utf-8", "replace")
    seconds, resident = used.ru_utime + used.ru_stime, used.ru_maxrss * 1024
    waited = time.monotonic() - begin
    wrong = []
    if code not in case.codes:
        wrong.append(f"exit code {code}")
    if "Traceback" in said or b"Traceback" in printed:
        wrong.append("a traceback")
    if "fault of linkplan's own" in said:
        wrong.append("a fault of its own")
    if seconds > LIMIT_S or waited > 2 * LIMIT_S - 1:
        wrong.append(f"{seconds:.0f} s of processor time, {waited:.0f} s")
    if resident > case.most_bytes:
        wrong.append(f"{resident / 1e9:.2f} GB")
    refusals = [line for line in said.splitlines() if not re.match(r"  \w+ +\d+\.\d s: ", line)]
    if code == 2 and 2 not in case.closed and resource.RLIMIT_FSIZE not in case.limits and len(refusals) != case.lines:
        wrong.append(f"{len(refusals)} lines")
    if case.says and not re.search(case.says, said + printed.decode("utf-8", "replace")):
        wrong.append(f"does not say {case.says!r}")
    if any(not c.isprintable() and c not in "\n" for c in said):
        wrong.append("control characters on stderr")
    now = content(folder)
    wrong += [f"{name} is changed or lost" for name, data in before.items()
              if now.get(name) != data and not any(name.startswith(one) for one in case.changes)]  # fmt: skip
    wrong += [f"{p} is litter" for p in (str(p) for p in folder.rglob("*")) if ".linkplan-work-" in p or p.endswith(".part")]
    if case.after is not None:
        wrong += [why] if (why := case.after(folder)) else []
    return Outcome(
        name=case.name,
        code=code,
        seconds=seconds,
        resident=resident,
        said=said[-1500:] or printed[-300:].decode("utf-8", "replace"),
        wrong="; ".join(wrong),
    )


def main() -> int:
    """Run the cases and print what came of them; 1 where something was wrong."""
    from tests.bench.hostile_cases import CASES

    words = sys.argv[1:]
    verbose = "-v" in words
    words = [word for word in words if word != "-v"]
    cases = [case for case in CASES if not words or any(word in case.name for word in words)]
    bad = 0
    with tempfile.TemporaryDirectory() as place:
        root = Path(place).resolve()
        root.chmod(0o755)
        (root / "cache").mkdir(mode=0o700)
        subprocess.run(
            [sys.executable, "-m", "linkplan", "plan", "knee-reach", "-o", str(root / "planned")],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        for case in cases:
            found = run_case(case, root / "planned", root)
            bad += bool(found.wrong)
            if found.wrong or verbose:
                print(
                    f"{found.name}: exit code {found.code}, {found.seconds:.1f} s, {found.resident / 1e6:.0f} MB: "
                    f"{'WRONG ' + found.wrong if found.wrong else 'right'}\n    {found.said.strip()}",
                    flush=True,
                )
    print(f"{len(cases)} cases, wrong {bad}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
