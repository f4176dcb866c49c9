"""Hostile surroundings: `python -m tests.bench.hostile [WORD ...]` runs each case whose name has one of the words in it.

Each case is a command line, by default of all cases, as a process of its own in a folder of its own. What must hold: an exit
code that the case allows, no traceback, no fault of linkplan's own, one line of refusal where the code is 2, an answer
within 30 s of processor time, at most 2 GB resident, no file of the user's changed, and no litter. Permissions and mounts
want Linux and root.
"""

import json
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from linkplan.models.catalogue import built_in_text
from linkplan.planner.files.tables import built_in_text as problem_text

LIMIT_S, LIMIT_BYTES = 30.0, 2_000_000_000
# Root without the right to overrule permissions.
UNPRIVILEGED = ("setpriv", "--bounding-set=-dac_override,-dac_read_search,-fowner,-sys_resource,-sys_admin")
KNEE, REACH = built_in_text("optimus-knee"), problem_text("knee-reach")
INTO_OUT = ("plan", "knee-reach", "--set", "mesh.intervals=10", "-o", "out")
OF_FILE = ("plan", "p.toml", "--set", "mesh.intervals=10", "--set", "solver.max_time_s=5")
TRACK, REPORT = ("track", "planned"), ("report", "planned")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Case:
    """A command line among hostile surroundings.

    `files` are written first, then `make` is called with the folder, in which `planned` is a saved plan. `env` goes over the
    environment, `limits` are resource limits; `changes` are beginnings of names of files that may change.
    """

    name: str
    words: tuple[str, ...]
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    make: Callable[[Path], object] = lambda _: None
    env: Mapping[str, str] = field(default_factory=dict)
    limits: Mapping[int, int] = field(default_factory=dict)
    codes: tuple[int, ...] = (2,)
    unprivileged: bool = False
    changes: tuple[str, ...] = ("out/",)
    stdout: str | None = None


def model(name: str, old: str, new: str, codes: tuple[int, ...] = (2,), **more) -> Case:
    """Return a check of the knee's model with a text replaced."""
    if old not in KNEE:
        raise ValueError(f"{old!r} is not in the model")
    files = {"m.xml": KNEE.replace(old, new)} | more.pop("files", {})
    return Case(name=f"model {name}", words=("check", "m.xml"), files=files, codes=codes, **more)


def problem(name: str, old: str, new: str, codes: tuple[int, ...] = (2,)) -> Case:
    """Return a plan of the knee's reach with a text replaced."""
    if old not in REACH:
        raise ValueError(f"{old!r} is not in the problem")
    return Case(name=f"problem {name}", words=OF_FILE, files={"p.toml": REACH.replace(old, new)}, codes=codes)


def saved(name: str, make: Callable[[Path], object], words: tuple[str, ...] = TRACK, codes=(1, 2), **more) -> Case:
    """Return a command on a saved plan that was changed."""
    return Case(name=f"saved {name}", words=words, make=make, codes=codes, **more)


def place(name: str, make: Callable[[Path], object] = lambda _: None, words: tuple[str, ...] = INTO_OUT, **more) -> Case:
    """Return a command that writes into a hostile place."""
    return Case(name=f"place {name}", words=words, make=make, **more)


def record(**changes) -> Callable[[Path], object]:
    """Return what changes keys of a plan's record."""

    def make(folder: Path) -> None:
        path = folder / "planned/plan.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | changes))

    return make


def archived(name: str, data: bytes) -> Callable[[Path], object]:
    """Return what puts a member into the archive of a plan's arrays, packed."""

    def make(folder: Path) -> None:
        path = folder / "planned/trajectory.npz"
        with zipfile.ZipFile(path) as archive:
            held = {one: archive.read(one) for one in archive.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for one, content in (held | {name: data}).items():
                archive.writestr(one, content)

    return make


def header(text: str) -> bytes:
    """Return the bytes of an array whose header is a text."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + bytes(64)


def mounted(*options: str) -> Callable[[Path], object]:
    """Return what mounts a small file system on `mounted`."""

    def make(folder: Path) -> None:
        (folder / "mounted").mkdir()
        subprocess.run(["mount", "-t", "tmpfs", *options, "tmpfs", str(folder / "mounted")], check=True)

    return make


def png(width: int, height: int) -> bytes:
    """Return the beginning of a grey picture that says how large it is."""
    head, rows = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0), zlib.compress(bytes(width + 1))
    parts = ((b"IHDR", head), (b"IDAT", rows), (b"IEND", b""))
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def instead(path: str, act: Callable[[Path], object]) -> Callable[[Path], object]:
    """Return what puts something else in the place of a file."""
    return lambda folder: ((folder / path).unlink(), act(folder / path))


END, ANY = "</mujoco>", (0, 1, 2)
MESHED = '<asset><mesh name="m" file="{}"/></asset></mujoco>'
TEXTURED = '<asset><texture name="t" type="2d" file="a.png"/><material name="t" texture="t"/></asset></mujoco>'
MOTOR = '<motor name="act_O" joint="O" ctrlrange="-100 100"/>'
OBJECTS = "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}"
SCRIPT = "</script><script>alert(1)</script>"
GROWING = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">' + "".join(
    f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(12)
)
CASES = (
    model("of entities that grow", "<mujoco", GROWING + "]><mujoco", (0, 2)),
    model("that includes itself", END, '<include file="m.xml"/></mujoco>'),
    model("that includes a device", END, '<include file="/dev/zero"/></mujoco>'),
    model("with an unknown plugin", END, '<extension><plugin plugin="no.such"/></extension></mujoco>'),
    model("with a mesh that is a pipe", END, MESHED.format("a.stl"), make=lambda f: os.mkfifo(f / "a.stl")),
    model("with a mesh by a device", END, MESHED.format("/dev/zero")),
    model("of 2^31 triangles", END, MESHED.format("a.stl"), files={"a.stl": bytes(80) + struct.pack("<I", 2**31)}),
    model("of a huge texture", END, TEXTURED, (0,), files={"a.png": png(60_000, 60_000)}),
    model("of a million copies", "</worldbody>", '<replicate count="1000000"><site/></replicate></worldbody>'),
    model("of a size without end", END, '<size memory="99999999999999999999E"/></mujoco>'),
    model("of a sensor of a billion numbers", END, '<sensor><user name="u" dim="1000000000"/></sensor></mujoco>'),
    model("of a filter of NaN", MOTOR, MOTOR.replace("motor", 'general dyntype="filterexact" dynprm="nan"')),
    model("of zero mass", 'density="1000"', 'density="0"', ANY),
    model("of huge gear", 'ctrlrange="-100 100"', 'ctrlrange="-100 100" gear="1e11"', ANY),
    model("with names of options", '"O"', '"--json"', (0,)),
    model("with names that turn the writing", '"O"', '"\u202eO"'),
    model("with names in emoji", '"O"', '"\U0001f9bf"', (0,)),
    Case(name="model in UTF-16", words=("check", "m.xml"), files={"m.xml": KNEE.encode("utf-16")}),
    Case(name="model of 3000 levels", words=("check", "m.xml"), files={"m.xml": "<mujoco><worldbody>" + "<body>" * 3000}),
    problem("of a duration of 1e-300 s", "0.16", "1e-300", (1, 2)),
    problem("of a duration of 1e308 s", "0.16", "1e308"),
    problem("of a duration of a date", "0.16", "1979-05-27T07:32:00Z"),
    problem("of a start that is its goal", "O = -49.07", "O = 56.27", ANY),
    problem("with a Cyrillic o", "duration_s", "durati\u043en_s"),
    problem("of 50,000 waypoints", "[objective]", "[[motion.waypoints]]\nat_deg = { O = 1.0 }\n" * 50_000 + "[objective]"),
    problem("of 100,000 dotted levels", "[objective]", "a" + ".a" * 100_000 + " = 1\n[objective]"),
    problem("with limits of nothing", "[objective]", "[limits]\neffort = { act_O = [0.0, 0.0] }\n[objective]", (1, 2)),
    Case(name="problem that is a pipe", words=("plan", "f.toml"), make=lambda f: os.mkfifo(f / "f.toml")),
    Case(name="problem that is a device", words=("plan", "/dev/random")),
    Case(name="problem in a circle of links", words=("plan", "a.toml"), make=lambda f: os.symlink("a.toml", f / "a.toml")),
    saved("with a record of a list", lambda f: (f / "planned/plan.json").write_text("[]")),
    saved("with a record nested deeply", lambda f: (f / "planned/plan.json").write_text("[" * 100_000)),
    saved("with a record that is a pipe", instead("planned/plan.json", os.mkfifo)),
    saved("with a motion that is a folder", instead("planned/trajectory.npz", Path.mkdir)),
    saved("of a problem of lists", record(problem=[])),
    saved("with a name of lines", record(name="a\nb\r\x1b[2J\t"), (*TRACK, "-o", "out"), ANY),
    saved("with a script in its name", record(name=SCRIPT), REPORT, (0,)),
    saved("with objects to unpickle", archived("effort.npy", header(OBJECTS))),
    saved("with a header of code", archived("effort.npy", header("__import__('os').system('touch mine')"))),
    saved("with a bomb", archived("effort.npy", bytes(500_000_000))),
    saved("with members that climb", archived("../../evil.npy", b"x"), codes=(0,)),
    saved("over a plan whose manifest lists the user's file", record(), ("plan", "knee-reach", "-o", "planned"), ANY,
          files={"thesis.tex": "mine"}, changes=("planned/",)),
    place("without permission", lambda f: (f / "d").mkdir(0o555), ("plan", "knee-reach", "-o", "d/out"), unprivileged=True),
    place("that is a file", lambda f: (f / "out").write_text("mine"), changes=()),
    place("that is a folder of the user's", lambda f: ((f / "out").mkdir(), (f / "out/mine").write_text("")), changes=()),
    place("that is the root", words=("plan", "knee-reach", "-o", "/")),
    place("that is a device", words=("report", "planned", "-o", "/dev/zero")),
    place("on a disk of 16 kB", mounted("-o", "size=16k"), ("plan", "knee-reach", "-o", "mounted/out")),
    place("on a disk of 6 files", mounted("-o", "nr_inodes=6"), ("plan", "knee-reach", "-o", "mounted/out")),
    place("with a cache of 4 kB", mounted("-o", "size=4k"), env={"LINKPLAN_CACHE": "mounted"}, codes=(0,)),
    place("where no file may grow", limits={resource.RLIMIT_FSIZE: 3000}),
    place("with ten open files", limits={resource.RLIMIT_NOFILE: 10}, codes=(0, 2)),
    place("with 350 MB of memory", limits={resource.RLIMIT_AS: 350_000_000}, codes=(0, 2)),
    place("whose stdout is full", words=("list",), stdout="/dev/full"),
    place("without a language", env={"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii"}, codes=(0,)),
    place("where warnings are errors", words=(*TRACK, "-o", "out"), env={"PYTHONWARNINGS": "error"}, codes=(0,)),
    place("with a compiler in quotes", words=(*INTO_OUT, "--set", "solver.compile=always"), env={"CC": 'gcc "'}, codes=(0,)),
)  # fmt: skip


def content(folder: Path) -> dict[str, bytes]:
    """Return every regular file below a folder with its bytes; links are not followed."""
    found = {str(p.relative_to(folder)): p for p in folder.rglob("*") if p.is_file() and not p.is_symlink()}
    return {name: path.read_bytes() for name, path in found.items() if path.stat().st_size < 50_000_000}


def run_case(case: Case, folder: Path) -> tuple[str, str]:
    """Return what is wrong after a case was run in a folder that holds a saved plan, and what was said."""
    for name, text in case.files.items():
        (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    case.make(folder)
    before, ours = content(folder), {"LINKPLAN_CACHE": str(folder.parent / "cache"), "HOME": str(folder.parent)}
    argv = [*(UNPRIVILEGED if case.unprivileged else ()), sys.executable, "-m", "linkplan", *case.words]

    def prepare() -> None:
        for number, most in case.limits.items():
            resource.setrlimit(number, (most, most))

    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        target = out if case.stdout is None else Path(case.stdout).open("wb")  # noqa: SIM115
        given = {**os.environ, "OMP_NUM_THREADS": "1", **ours, **case.env}
        process = subprocess.Popen(argv, cwd=folder, env=given, stdin=-3, stdout=target, stderr=err, preexec_fn=prepare)
        timer = threading.Timer(3 * LIMIT_S, os.kill, (process.pid, signal.SIGKILL))
        timer.start()
        _, status, used = os.wait4(process.pid, 0)
        timer.cancel()
        process.returncode = code = os.waitstatus_to_exitcode(status)
        out.seek(0), err.seek(0)
        printed, said = out.read(), err.read().decode("utf-8", "replace")
    after, refusals = content(folder), [line for line in said.splitlines() if not re.match(r"  \w+ +\d+\.\d s: ", line)]
    found = {
        f"exit code {code}": code not in case.codes,
        "a traceback": "Traceback" in said or b"Traceback" in printed,
        "a fault of its own": "fault of linkplan's own" in said,
        "too slow": used.ru_utime + used.ru_stime > LIMIT_S,
        "too large": used.ru_maxrss * 1024 > LIMIT_BYTES,
        "not one line": code == 2 and not case.limits and len(refusals) != 1,  # CasADi says more where it lacks memory
        "control characters": any(not c.isprintable() and c != "\n" for c in said),
        "a script in a page": any(name.endswith(".html") and SCRIPT.encode() in data for name, data in after.items()),
        "litter": any(".linkplan-work-" in name or name.endswith(".part") for name in after),
    }
    changed = [name for name, data in before.items() if after.get(name) != data and not name.startswith(case.changes or "?")]
    return "; ".join([what for what, is_wrong in found.items() if is_wrong] + [f"{name} changed" for name in changed]), said


def main(words: list[str]) -> int:
    """Run the cases and print what was wrong; 1 where something was."""
    cases = [case for case in CASES if not words or any(word in case.name for word in words)]
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        root, folder = Path(name).resolve(), Path(name).resolve() / "here"
        root.chmod(0o755)
        (root / "cache").mkdir(0o700)
        plan = [sys.executable, "-m", "linkplan", "plan", "knee-reach", "-o", str(root / "planned")]
        subprocess.run(plan, check=True, stdout=subprocess.DEVNULL)
        for case in cases:
            shutil.copytree(root / "planned", folder / "planned")
            try:
                wrong, said = run_case(case, folder)
            finally:
                subprocess.run(["umount", "-q", str(folder / "mounted")], check=False, stderr=subprocess.DEVNULL)
                shutil.rmtree(folder, ignore_errors=True)
            bad += bool(wrong)
            if wrong:
                print(f"{case.name}: {wrong}\n    {said.strip()[-1000:]}", flush=True)
    print(f"{len(cases)} cases, wrong {bad}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
