"""Hostile processes and folders: how a process is begun, its clock, its signals, its terminal; results that were tampered with."""

# One case a line, of whatever length: a table.
# ruff: noqa: ARG005, E501
# fmt: off

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.bench.hostile import Case
from tests.bench.hostile_files import REACH

ANY = (0, 1, 2)
PLAN = ("plan", "knee-reach", "--set", "mesh.intervals=10", "-o", "out")
BATCH = 'problem = "knee-reach"\n[[case]]\nset = ["motion.goal_deg.O=20"]\n'
MAIN = "import sys; sys.argv[0] = 'linkplan'; from linkplan.__main__ import main; main()"
# Real time begins where $BEGIN says [s] and jumps by $JUMP at every reading.
_CLOCK_C = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
#include <sys/time.h>
static double now(void) { static int calls; return atof(getenv("BEGIN")) + atof(getenv("JUMP")) * calls++; }
int clock_gettime(clockid_t c, struct timespec *t) {
  int (*real)(clockid_t, struct timespec *) = dlsym(RTLD_NEXT, "clock_gettime");
  if (c != CLOCK_REALTIME) return real(c, t);
  double s = now(); t->tv_sec = (time_t)s; t->tv_nsec = 0; return 0; }
time_t time(time_t *t) { time_t s = (time_t)now(); if (t) *t = s; return s; }
int gettimeofday(struct timeval *t, void *z) { (void)z; t->tv_sec = (time_t)now(); t->tv_usec = 0; return 0; }
"""
_LIBRARY: list[str] = []


def clock() -> str:
    """Return a library that lets the clock on the wall stand or jump, compiled once."""
    if not _LIBRARY:
        place = Path(tempfile.mkdtemp(prefix="hostile-"))
        place.chmod(0o755)
        (place / "clock.c").write_text(_CLOCK_C)
        subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", place / "clock.so", place / "clock.c", "-ldl"], check=True)
        _LIBRARY.append(str(place / "clock.so"))
    return _LIBRARY[0]


def process(name: str, *words: str, codes: tuple[int, ...] = (0,), **more) -> Case:
    return Case(name=f"process {name}", words=words or PLAN, codes=codes, **({"make": lambda _: None} if "planned" in words else {}), **more)


def begun(name: str, code: str, *words: str, **more) -> Case:
    """Return a case whose process runs some lines before linkplan's."""
    return process(name, *words, program=("-c", f"import os, signal, sys, shutil\n{code}\n{MAIN}"), **more)


def options(name: str, *python: str, words: tuple[str, ...] = (), **more) -> Case:
    return process(f"of python {name}", *words, program=(*python, "-m", "linkplan"), **more)


def at(name: str, begin: float, jump: float, *words: str, **more) -> Case:
    return process(f"whose clock {name}: {(words or PLAN)[0]}", *words, env={"LD_PRELOAD": clock(), "BEGIN": str(begin), "JUMP": str(jump)}, **more)


def folder(name: str, make, *words: str, **more) -> Case:
    return Case(name=f"folder {name}", words=words or ("plan", "knee-reach", "--set", "mesh.intervals=10", "-o", "planned"), make=make, **{"codes": ANY, "changes": ("planned/plan", "planned/traj", "planned/.linkplan"), **more})


def mine(place: str, text: str = "mine"):
    """Return what says that a file of the user's is lost."""
    return lambda f: "" if (f / place).exists() and (f / place).read_text() == text else f"{place} of the user's is lost"


def manifest(change):
    """Return what changes a saved plan's manifest."""
    def make(f: Path) -> None:
        (f / "thesis.tex").write_text("mine")
        (f / "planned/notes.txt").write_text("mine")
        path = f / "planned/.linkplan.json"
        said = change(json.loads(path.read_text()))
        path.write_text(said if isinstance(said, str) else json.dumps(said))

    return make


def listing(*names: str):
    return manifest(lambda said: {**said, "files": [*said["files"], *names] if isinstance(said["files"], list) else {**said["files"], **dict.fromkeys(names, "")}})


def other_plan(f: Path, *words: str) -> None:
    """Plan another motion of the same knee into `other`."""
    subprocess.run([sys.executable, "-m", "linkplan", "plan", "knee-reach", "--set", "motion.goal_deg.O=20", "--set", "mesh.intervals=10", *words, "-o", "other"], cwd=f, check=True, capture_output=True)


def swapped(*names: str):
    """Return what takes files of another plan's folder."""
    def make(f: Path) -> None:
        other_plan(f)
        for name in names:
            shutil.copy(f / "other" / name, f / "planned" / name)

    return make


def linked(f: Path) -> None:
    """Let a file of the user's be the same file as a result's."""
    os.link(f / "planned/plan.json", f / "thesis.json")
    os.link(f / "planned/trajectory.csv", f / "data.csv")


def symlinked(name: str, to: str):
    def make(f: Path) -> None:
        (f / to).parent.mkdir(exist_ok=True, parents=True)
        shutil.move(f / "planned" / name, f / to)
        os.symlink(os.path.relpath(f / to, f / "planned"), f / "planned" / name)

    return make


def dated(seconds: float):
    def make(f: Path) -> None:
        for path in (*f.rglob("*"), f / "planned"):
            os.utime(path, (seconds, seconds))

    return make


OVERHEARD = "signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 65))"
TERMINAL = """
import fcntl, pty, struct, termios
pid, fd = pty.fork()
if pid:
    fcntl.ioctl(fd, termios.TIOCSWINSZ, struct.pack('HHHH', {0}, {1}, 0, 0))
    said = b''
    try:
        while True:
            part = os.read(fd, 4096)
            if not part: break
            said += part
    except OSError: pass
    if b'Traceback' in said: sys.stderr.write('Traceback on the terminal')
    sys.exit(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
import time
time.sleep(0.1)
"""
ALONE = "import subprocess\nos.unshare(0x00020000)\nsubprocess.run(['mount', '--make-rprivate', '/'], check=True)\n" if hasattr(os, "unshare") else """
import ctypes, subprocess
ctypes.CDLL(None).unshare(0x00020000)
subprocess.run(['mount', '--make-rprivate', '/'], check=True)
"""
UNMOUNTED = ALONE + "subprocess.run(['umount', '-l', '{0}'], check=True)"
COVERED = ALONE + "subprocess.run(['mount', '-t', 'tmpfs', '-o', 'ro,size=4k', 'tmpfs', '{0}'], check=True)"
WITH_PLAN = (("track", "planned"), ("compare", "planned", "--trackers", "pd"), ("report", "planned"), ("export", "planned", "--to", "csv", "-o", "x.csv"), ("render", "planned", "--size-px", "64x64", "-o", "x.gif"), ("experiment", "planned", "--samples", "2", "--trackers", "pd", "-o", "tried"))
PROCESSES = (
    begun("whose folder is gone", "os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')", codes=(2,)), begun("whose folder is gone, asked for a list", "os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')", "list"), begun("whose folder is gone, checking a file", "os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')", "check", "m.xml", codes=(2,)), begun("whose folder is gone, with a whole path", "there = os.getcwd(); os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone'); sys.argv[-1] = there + '/out'", codes=(0, 2)), begun("whose folder is gone, in a batch", "here = os.getcwd(); os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone')", "batch", "b.toml", codes=(2,)),
    *(begun(f"that may make nothing to be read: {words[0]}", "os.umask(0o777)", *words, codes=(0, 2), unprivileged=True) for words in (PLAN, *WITH_PLAN[2:], ("schema", "-o", "s.json"), ("new", "optimus-knee", "-o", "n.toml"))),
    begun("that may make nothing to be read: batch", "os.umask(0o777)", "batch", "b.toml", "-o", "b", codes=(0, 2), unprivileged=True, files={"b.toml": BATCH}), begun("that shares everything it makes", "os.umask(0)", codes=(0,)),
    begun("without /proc", UNMOUNTED.format("/proc")), begun("without /proc, tracking", UNMOUNTED.format("/proc"), "track", "planned"), begun("without /proc, trying", UNMOUNTED.format("/proc"), "experiment", "planned", "--samples", "2", "--trackers", "pd"), begun("without /dev/shm, by workers", COVERED.format("/dev/shm"), "experiment", "planned", "--samples", "200", "--trackers", "pd", "--workers", "2", "--set", "tracking.duration_s=0.01", "-o", "tried"), begun("without /dev", COVERED.format("/dev"), codes=(0, 2)), begun("with a read-only /tmp, compiling", COVERED.format("/var/tmp"), "plan", "knee-reach", "--set", "mesh.intervals=10", "--set", "solver.compile=always", "-o", "out", env={"TMPDIR": "/var/tmp"}),
    *(begun(f"in which {what}", f"signal.signal(signal.{name}, signal.SIG_IGN)", *words) for what, name in (("children are not waited for", "SIGCHLD"), ("a broken pipe is nothing", "SIGPIPE"), ("an interrupt is nothing", "SIGINT"), ("a clock rings for nobody", "SIGALRM")) for words in (("plan", "knee-reach", "--set", "mesh.intervals=10", "--set", "solver.compile=always", "-o", "out"), ("experiment", "planned", "--samples", "200", "--trackers", "pd", "--workers", "2", "--set", "tracking.duration_s=0.01", "-o", "tried"))), begun("that hears no signal", OVERHEARD), begun("that a broken pipe ends", "signal.signal(signal.SIGPIPE, signal.SIG_DFL)"), begun("that an alarm ends", "signal.setitimer(signal.ITIMER_REAL, 0.3)", codes=(0, -14, 142)),
    *(begun(f"on a terminal of {high} by {wide}: {words[0]}", TERMINAL.format(high, wide), *words) for high, wide in ((1, 1), (0, 0), (65535, 65535)) for words in (PLAN, ("check", "optimus-knee"), ("list",))),
    begun("whose stdout never blocks", "os.set_blocking(1, False); os.set_blocking(2, False)"), begun("of ten thousand variables", "os.environ.update({f'X{k}': 'y' * 50 for k in range(10000)})"), begun("in a deep folder", "for k in range(60): os.mkdir('d' * 60); os.chdir('d' * 60)", codes=(0, 2)), begun("with little stack for Python", "sys.setrecursionlimit(200)", codes=(0, 2)), begun("without standard streams in Python", "sys.stdin = None"),
    at("stands before 1970", -1e9, 0.0), at("stands in 1970", 0.0, 0.0), at("stands in 2261", 9.2e9, 0.0), at("goes backwards", 1.7e9, -1.0), at("leaps by months", 1.7e9, 1e7), *(at("stands before 1970", -1e9, 0.0, *words) for words in WITH_PLAN), *(at("goes backwards", 1.7e9, -1.0, *words) for words in (*WITH_PLAN, ("plan", "knee-reach", "--set", "mesh.intervals=10", "--set", "solver.compile=always", "-o", "out"))), at("stands before 1970", -1e9, 0.0, "batch", "b.toml", "-o", "b", files={"b.toml": BATCH}), at("stands before 1980", 3e8, 0.0, "export", "planned", "--to", "mat", "-o", "x.mat"), at("stands beyond 2107", 5e9, 0.0),
    *(options(name, *python, **more) for name, python, more in (("that warns as errors", ("-W", "error"), {}), ("for developers", ("-X", "dev"), {}), ("for developers, errors all", ("-X", "dev", "-W", "error"), {}), ("without asserts and texts", ("-OO",), {}), ("strict of bytes", ("-bb",), {}), ("of ASCII", ("-X", "utf8=0"), {"env": {"LC_ALL": "C", "LANG": None, "PYTHONCOERCECLOCALE": "0"}}), ("of short integers", ("-X", "int_max_str_digits=640"), {}), ("that traces memory", ("-X", "tracemalloc=5"), {}), ("that warns of encodings", ("-X", "warn_default_encoding"), {}), ("unbuffered", ("-u",), {}), ("frozen off", ("-X", "frozen_modules=off"), {}), ("that compiles nothing", ("-B",), {}))),
    *(options(f"for developers, errors all: {' '.join(words)[:30]}", "-X", "dev", "-W", "error", words=words, **more) for words, more in ((("batch", "b.toml", "-o", "b"), {"files": {"b.toml": BATCH}}), (("tune", "optimus-knee", "--bandwidth-hz", "5", "--at-deg", "3.6"), {"codes": (0, 1)}), (("new", "slider-crank"), {}), (("schema",), {}), (("completion", "zsh"), {}), (("list",), {}), (("bode", "optimus-knee", "--at-deg", "3.6", "--no-measure", "-o", "out"), {}), (("decompose", "planned", "--trackers", "pd"), {"codes": (0, 1, 2)}), *((words, {}) for words in WITH_PLAN))),
    *(options(f"without asserts and texts: {words[0]}", "-OO", words=words) for words in (*WITH_PLAN, ("check", "optimus-knee", "-o", "out"), ("new", "slider-crank"))),
    process("alone", program=("-I", "-c", f"import sys; sys.path[:0] = {os.environ.get('PYTHONPATH', '').split(os.pathsep)!r}; {MAIN}")), process("of no language", "check", "optimus-knee", env={"LANG": None, "LC_ALL": None, "LC_CTYPE": None}), *(process(f"of a backend of nothing: {words[0]}", *words, env={"MPLBACKEND": "nonsense", "MUJOCO_GL": "nonsense", "PYOPENGL_PLATFORM": "nonsense", "CC": "nonsense"}, codes=(0, 2)) for words in WITH_PLAN), process("of a compiler of nothing: batch", "batch", "b.toml", "-o", "b", files={"b.toml": BATCH}, env={"CC": "/dev/null"}), process("of a compiler that fails", "plan", "knee-reach", "--set", "mesh.intervals=10", "--set", "solver.compile=always", "-o", "out", env={"CC": "false"}), process("of a compiler that sleeps", "plan", "knee-reach", "--set", "mesh.intervals=10", "--set", "solver.compile=always", "--set", "solver.max_time_s=5", "-o", "out", env={"CC": "sleep"}, codes=ANY), process("of one column: bode", "bode", "optimus-knee", "--at-deg", "3.6", "--no-measure", env={"COLUMNS": "1"}), *(process(f"of one column: {words[0]}", *words, env={"COLUMNS": "1"}) for words in WITH_PLAN[:2]),
)
TAMPERED = (
    folder("of another plan's motion", swapped("trajectory.npz"), "track", "planned", codes=(1, 2)), folder("of another plan's record", swapped("plan.json"), "track", "planned", codes=(1, 2)), folder("of another plan's motion, all the same", swapped("trajectory.npz"), "track", "planned", "--anyway", codes=(1,)), folder("of another plan's motion and record", swapped("plan.json", "trajectory.npz"), "track", "planned", codes=(0,)), folder("of another plan's table", swapped("trajectory.csv"), "report", "planned", codes=(0, 1, 2)), folder("of another plan's manifest", swapped(".linkplan.json"), codes=(0, 2)),
    *(folder(f"whose manifest lists {name}", listing(name), after=mine(lost), codes=(0, 2)) for name, lost in (("../thesis.tex", "thesis.tex"), ("../../../../../../../../etc/hostname", "thesis.tex"), ("/etc/hostname", "thesis.tex"), ("notes.txt", "planned/notes.txt"), ("", "planned/notes.txt"), (".", "planned/notes.txt"), ("..", "thesis.tex"), ("a/../../thesis.tex", "thesis.tex"), ("x\0y", "thesis.tex"), ("x" * 5000, "thesis.tex"), ("\u202e", "thesis.tex")) if name != "notes.txt"),
    *(folder(f"whose manifest is {name}", manifest(change), after=mine("planned/notes.txt"), codes=(0, 2)) for name, change in (("nothing", lambda said: ""), ("a list", lambda said: []), ("without files", lambda said: {k: v for k, v in said.items() if k != "files"}), ("of files that are a number", lambda said: {**said, "files": 5}), ("of files that are tables", lambda said: {**said, "files": [{}]}), ("of another kind", lambda said: {**said, "record": "bode.json"}), ("without an identity", lambda said: {k: v for k, v in said.items() if k != "identity"}), ("of a later version", lambda said: {**said, "version": 10**30}), ("of a million files", lambda said: {**said, "files": [f"f{k}" for k in range(1_000_000)]}), ("deep", lambda said: "[" * 100_000))),
    folder("whose files are hard links", linked, codes=(0,), after=lambda f: "" if (f / "thesis.json").stat().st_nlink == 1 else "still linked"),
    *(folder(f"whose {name} is a link to {to}", symlinked(name, to), codes=(0, 2)) for name, to in (("plan.json", "mine/plan.json"), ("trajectory.npz", "mine/t.npz"), ("plan.png", "mine/p.png"), (".linkplan.json", "mine/m.json"))), *(folder(f"tracked whose {name} is a link to {to}", symlinked(name, to), "track", "planned", codes=(0,)) for name, to in (("plan.json", "mine/plan.json"), ("trajectory.npz", "mine/t.npz"))), folder("with a link to a thesis in it", lambda f: ((f / "mine").mkdir(), (f / "mine/thesis.tex").write_text("mine"), os.symlink("../mine", f / "planned/mine")), after=mine("mine/thesis.tex"), codes=(0,)), folder("with a link to nothing in it", lambda f: os.symlink("no/such", f / "planned/l"), codes=(0,)), folder("with a link to itself in it", lambda f: os.symlink("l", f / "planned/l"), codes=(0,)), folder("with a link to its parent in it", lambda f: os.symlink("..", f / "planned/up"), codes=(0,)), folder("with a pipe in it", lambda f: os.mkfifo(f / "planned/p"), codes=(0,)), folder("with a folder in it that may not be read", lambda f: ((f / "planned/d").mkdir(), (f / "planned/d/x").write_text("mine"), (f / "planned/d").chmod(0)), codes=(0, 2), unprivileged=True), folder("with a deep folder in it", lambda f: (f / "planned" / "/".join(["d" * 50] * 60)).mkdir(parents=True), codes=(0, 2)), folder("with a thousand files in it", lambda f: [(f / f"planned/{k}.txt").write_text("mine") for k in range(1000)] and None, after=mine("planned/999.txt"), codes=(0,)),
    folder("that may only be read", lambda f: [p.chmod(0o444) for p in (f / "planned").iterdir()] and None, unprivileged=True, codes=(0, 2)), folder("that may only be read, tracked", lambda f: ([p.chmod(0o444) for p in (f / "planned").iterdir()], (f / "planned").chmod(0o555)), "track", "planned", unprivileged=True, codes=(0,)), folder("that is sticky and not ours", lambda f: (f / "planned").chmod(0o1777), codes=(0,)), folder("whose files are set to run as root", lambda f: (f / "planned/plan.json").chmod(0o6777), codes=(0,)),
    *(folder(f"of the year {name}", dated(seconds), *words, codes=(0,)) for name, seconds in (("1969", -1e7), ("1901", -2**31), ("2446", 1.5e10)) for words in ((), ("track", "planned"), ("report", "planned"))),
    *(folder(f"written into itself: {' '.join(words)}", lambda f: None, *words, codes=(0, 2)) for words in (("track", "planned", "-o", "planned"), ("track", "planned", "-o", "planned/tracked"), ("compare", "planned", "-o", "planned/../planned/compared"), ("experiment", "planned", "--samples", "2", "--trackers", "pd", "-o", "planned/tried"), ("report", "planned", "-o", "planned/report.html"), ("report", "planned", "-o", "planned/plan.json"), ("export", "planned", "--to", "csv", "-o", "planned/.linkplan.json"), ("render", "planned", "--size-px", "64x64", "-o", "planned/trajectory.npz"), ("render", "planned", "--size-px", "64x64", "-o", "planned/plan.png"), ("plan", "knee-reach", "-o", "planned//."), ("plan", "knee-reach", "-o", "planned/plan.json"), ("plan", "knee-reach", "-o", "planned/plan.json/x"), ("bode", "optimus-knee", "--at-deg", "3.6", "--no-measure", "-o", "planned"), ("check", "optimus-knee", "-o", "planned"), ("demo", "-o", "planned"), ("batch", "b.toml", "-o", "planned"))),
    folder("beside parts of another run", lambda f: ((f / "planned.unfinished").mkdir(), (f / "planned.unfinished/thesis").write_text("mine")), "experiment", "planned", "--samples", "2", "--trackers", "pd", "-o", "planned", after=mine("planned.unfinished/thesis"), codes=(2,)), folder("beside parts of a user's", lambda f: ((f / "tried.unfinished").mkdir(), (f / "tried.unfinished/thesis").write_text("mine")), "experiment", "planned", "--samples", "2", "--trackers", "pd", "-o", "tried", after=mine("tried.unfinished/thesis"), codes=(0, 2)), folder("beside parts that are a link", lambda f: ((f / "mine").mkdir(), (f / "mine/thesis").write_text("mine"), os.symlink("mine", f / "tried.unfinished")), "experiment", "planned", "--samples", "2", "--trackers", "pd", "-o", "tried", after=mine("mine/thesis"), codes=(0, 2)), folder("with a guess in a link", lambda f: (os.symlink("planned", f / "guess"), (f / "p.toml").write_text(REACH + '\n[guess]\nplan = "guess"\n')), "plan", "p.toml", "-o", "out", codes=(0,)),
)
PROCESSES = (*PROCESSES, *TAMPERED)
