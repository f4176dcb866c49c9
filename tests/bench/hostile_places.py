"""Hostile places: folders without permission, disks that fail, limits of the system, surroundings of a process."""

# One case a line, of whatever length: a table.
# ruff: noqa: ARG005, E501
# fmt: off

import errno
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.bench.hostile import Case
from tests.bench.hostile_files import REACH

PLAN = ("plan", "knee-reach", "-o", "out")
TRACK = ("track", "planned", "-o", "out")
_FAIL_C = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <stdio.h>
#include <sys/types.h>
#include <sys/stat.h>
static int hit(const char *name) {
  const char *f = getenv("FAIL"); size_t n = strlen(name);
  if (!f || strncmp(f, name, n) || f[n] != ':') return 0;
  char *rest; errno = (int)strtol(f + n + 1, &rest, 10);
  static int calls; int from = *rest == ':' ? atoi(rest + 1) : 0;
  return calls++ >= from;
}
#define REAL(r, f, ...) r (*real)(__VA_ARGS__) = dlsym(RTLD_NEXT, #f)
int fsync(int d) { REAL(int, fsync, int); return hit("fsync") ? -1 : real(d); }
int rename(const char *a, const char *b) { REAL(int, rename, const char*, const char*); return hit("rename") ? -1 : real(a, b); }
int renameat2(int d, const char *a, int e, const char *b, unsigned f) {
  REAL(int, renameat2, int, const char*, int, const char*, unsigned); return hit("renameat2") ? -1 : real(d, a, e, b, f); }
int link(const char *a, const char *b) { REAL(int, link, const char*, const char*); return hit("link") ? -1 : real(a, b); }
int linkat(int d, const char *a, int e, const char *b, int f) {
  REAL(int, linkat, int, const char*, int, const char*, int); return hit("link") ? -1 : real(d, a, e, b, f); }
int flock(int d, int o) { REAL(int, flock, int, int); return hit("flock") ? -1 : real(d, o); }
int unlink(const char *a) { REAL(int, unlink, const char*); return hit("unlink") ? -1 : real(a); }
int rmdir(const char *a) { REAL(int, rmdir, const char*); return hit("rmdir") ? -1 : real(a); }
int chmod(const char *a, mode_t m) { REAL(int, chmod, const char*, mode_t); return hit("chmod") ? -1 : real(a, m); }
int mkdir(const char *a, mode_t m) { REAL(int, mkdir, const char*, mode_t); return hit("mkdir") ? -1 : real(a, m); }
int close(int d) { REAL(int, close, int); int r = real(d); return d > 2 && hit("close") ? -1 : r; }
"""
_LIBRARY: list[str] = []


def preload() -> str:
    """Return a library that lets calls of the system fail, compiled once."""
    if not _LIBRARY:
        place = Path(tempfile.mkdtemp(prefix="hostile-"))
        place.chmod(0o755)
        (place / "fail.c").write_text(_FAIL_C)
        subprocess.run(["gcc", "-shared", "-fPIC", "-O1", "-o", place / "fail.so", place / "fail.c", "-ldl"], check=True)
        _LIBRARY.append(str(place / "fail.so"))
    return _LIBRARY[0]


def earlier(folder: Path) -> None:
    """Let an earlier result stand in `out`, with a file of the user's in it."""
    shutil.copytree(folder / "planned", folder / "out")
    (folder / "out" / "notes.txt").write_text("mine")


def failing(call: str, number: int, *, from_call: int = 0, codes: tuple[int, ...] = (2,), words: tuple[str, ...] = PLAN, changes=None) -> Case:
    """Return a case in which a call of the system fails from some call on: the earlier result stays whole, or the new one is."""
    return Case(
        name=f"place where {call} fails with {errno.errorcode[number]} from call {from_call} on: {words[0]}",
        words=words, make=earlier if words[0] == "plan" else lambda _: None, env={"LD_PRELOAD": preload(), "FAIL": f"{call}:{number}:{from_call}"},
        codes=codes, after=whole, changes=("out/",) if changes is None else changes,
    )


def whole(folder: Path) -> str:
    """Return what is wrong with the result in `out`: it is whole, and the user's file in it is there."""
    out = folder / "out"
    if not (folder / "out").exists():
        return ""
    if out.is_file():
        return ""
    if not (out / ".linkplan.json").is_file():
        return "no manifest"
    said = json.loads((out / ".linkplan.json").read_text())
    lost = [name for name in said["files"] if not (out / name).is_file()]
    if (out / "plan.json").is_file() and not (out / "notes.txt").is_file():
        lost.append("notes.txt of the user's")
    return f"{', '.join(lost)} lost" if lost else ""


def later(seconds: float, act):
    """Return what acts on a folder once a process has run for some time."""
    def during(folder: Path, pid: int) -> None:
        time.sleep(seconds)
        act(folder, pid)

    return during


def when_working(act):
    """Return what acts on a folder once a work folder is in it."""
    def during(folder: Path, pid: int) -> None:
        until = time.monotonic() + 20
        while time.monotonic() < until and os.path.exists(f"/proc/{pid}/exe"):
            try:
                found = list(folder.glob(".linkplan-work-*"))
            except OSError:
                return
            if found:
                act(folder, found[0])
                return
            time.sleep(0.002)

    return during


def mounted(*options: str):
    """Return what mounts a file system of its own on `mounted`."""
    def make(folder: Path) -> None:
        (folder / "mounted").mkdir()
        subprocess.run(["mount", "-t", "tmpfs", *options, "tmpfs", str(folder / "mounted")], check=True)

    return make


def read_only(folder: Path) -> None:
    mounted()(folder)
    (folder / "mounted" / "p.toml").write_text(REACH)
    subprocess.run(["mount", "-o", "remount,ro", str(folder / "mounted")], check=True)


def without(mode: int, *names: str):
    """Return what takes permissions from files and folders."""
    def make(folder: Path) -> None:
        for name in names:
            (folder / name).mkdir(parents=True, exist_ok=True) if not (folder / name).exists() else None
            (folder / name).chmod(mode)

    return make


def place(name: str, *words: str, **more) -> Case:
    return Case(name=f"place {name}", words=words or PLAN, **more)


def limited(name: str, what: int, most: int, *words: str, codes: tuple[int, ...] = (0, 2), **more) -> Case:
    more = {"make": earlier, "changes": ("out/",)} | more if words in ((), PLAN) else more
    return Case(name=f"limit of {name} {most}: {(words or PLAN)[0]}", words=words or PLAN, limits={what: most}, codes=codes, after=whole, **more)


def with_env(name: str, *words: str, codes=(0,), **env) -> Case:
    return Case(name=f"surroundings {name}", words=words or PLAN, env=env, codes=codes)


def twice(folder: Path, pid: int) -> None:
    """Run the same command at the same time."""
    del pid
    done = subprocess.run([sys.executable, "-m", "linkplan", *PLAN], cwd=folder, capture_output=True, check=False)
    if done.returncode not in (0, 2) or b"Traceback" in done.stderr:
        (folder / "second-went-wrong").write_bytes(done.stderr)


PERMISSIONS = (
    place("without permission to write", "plan", "knee-reach", "-o", "locked/out", make=without(0o555, "locked"), unprivileged=True, says="permission|Permission"),
    place("without permission to look into", "plan", "knee-reach", "-o", "locked/out", make=without(0o000, "locked"), unprivileged=True),
    place("with an earlier result that may not be changed", make=lambda f: (earlier(f), without(0o555, "out")(f)), unprivileged=True, codes=(0, 2), after=whole, changes=("out/",)),
    place("with an earlier result that may not be read", make=lambda f: (earlier(f), without(0o000, "out")(f)), unprivileged=True, codes=(2,)),
    place("with an earlier record that may not be read", make=lambda f: (earlier(f), without(0o000, "out/plan.json", "out/.linkplan.json")(f)), unprivileged=True, codes=(2,)),
    place("with a plan that may not be read", "track", "planned", make=without(0o000, "planned/plan.json"), unprivileged=True),
    place("with a motion that may not be read", "track", "planned", make=without(0o000, "planned/trajectory.npz"), unprivileged=True),
    place("with a plan's folder that may not be read", "track", "planned", make=without(0o000, "planned"), unprivileged=True),
    place("with a problem that may not be read", "plan", "p.toml", files={"p.toml": REACH}, make=without(0o000, "p.toml"), unprivileged=True),
    place("with a problem in a folder that may not be read", "plan", "d/p.toml", files={"d/p.toml": REACH}, make=without(0o000, "d"), unprivileged=True),
    place("with a model that may not be read", "check", "m.xml", files={"m.xml": "<mujoco/>"}, make=without(0o000, "m.xml"), unprivileged=True),
    place("with a model in a folder that may not be read", "check", "d/m.xml", files={"d/m.xml": "<mujoco/>"}, make=without(0o000, "d"), unprivileged=True),
    place("with an include that may not be read", "check", "m.xml", files={"m.xml": '<mujoco><include file="n.xml"/></mujoco>', "n.xml": "<mujoco/>"}, make=without(0o000, "n.xml"), unprivileged=True),
    place("report without permission", "report", "planned", "-o", "locked/r.html", make=without(0o555, "locked"), unprivileged=True),
    place("export without permission", "export", "planned", "--to", "csv", "-o", "locked/x.csv", make=without(0o555, "locked"), unprivileged=True),
    place("render without permission", "render", "planned", "-o", "locked/x.png", make=without(0o555, "locked"), unprivileged=True),
    place("new without permission", "new", "optimus-knee", "-o", "locked/x.toml", make=without(0o555, "locked"), unprivileged=True),
    place("schema without permission", "schema", "-o", "locked/x.json", make=without(0o555, "locked"), unprivileged=True),
    place("experiment without permission", "experiment", "planned", "--samples", "2", "-o", "locked/x", make=without(0o555, "locked"), unprivileged=True),
    place("batch without permission", "batch", "b.toml", "-o", "locked/x", files={"b.toml": 'problem = "knee-reach"\n[[case]]\nset = ["motion.goal_deg.O=20"]\n'}, make=without(0o555, "locked"), unprivileged=True),
    place("working folder that may not be read", "plan", "knee-reach", make=lambda f: f.chmod(0o311), unprivileged=True, codes=(0,)),
    place("cache that may not be written", unprivileged=True, codes=(0,), make=lambda f: None),
)
DISKS = (
    place("on a read-only disk", "plan", "knee-reach", "-o", "mounted/out", make=read_only, says="[Rr]ead-only|permission"),
    place("with its problem on a read-only disk", "plan", "mounted/p.toml", "-o", "out", make=read_only, codes=(0,)),
    place("on a mount itself", "plan", "knee-reach", "-o", "mounted", make=mounted(), says="mounted"),
    place("on a disk of 16 kB", "plan", "knee-reach", "-o", "mounted/out", make=mounted("-o", "size=16k"), says="space"),
    place("on a disk of 128 kB", "plan", "knee-reach", "-o", "mounted/out", make=mounted("-o", "size=128k"), says="space"),
    place("on a disk of 6 files", "plan", "knee-reach", "-o", "mounted/out", make=mounted("-o", "nr_inodes=6"), says="space"),
    place("report on a disk of 16 kB", "report", "planned", "-o", "mounted/r.html", make=mounted("-o", "size=16k"), says="space"),
    place("export on a disk of 16 kB", "export", "planned", "--to", "csv", "-o", "mounted/x.csv", make=mounted("-o", "size=16k"), says="space"),
    place("export of Parquet on a disk of 16 kB", "export", "planned", "--to", "parquet", "-o", "mounted/x.parquet", make=mounted("-o", "size=8k"), says="space"),
    place("render on a disk of 4 kB", "render", "planned", "--size-px", "320x240", "-o", "mounted/x.gif", make=mounted("-o", "size=4k"), says="space"),
    place("render a film on a disk of 4 kB", "render", "planned", "--size-px", "320x240", "-o", "mounted/x.mp4", make=mounted("-o", "size=4k"), says="space"),
    place("new on a disk of 4 kB", "new", "optimus-knee", "-o", "mounted/x.toml", make=mounted("-o", "size=4k"), codes=(0, 2)),
    place("schema on a disk of 4 kB", "schema", "-o", "mounted/x.json", make=mounted("-o", "size=4k"), says="space"),
    place("experiment on a disk of 64 kB", "experiment", "planned", "--samples", "4", "--trackers", "pd", "-o", "mounted/x", make=mounted("-o", "size=64k"), says="space"),
    place("temporary folder of 4 kB", "experiment", "planned", "--samples", "4", "--trackers", "pd", make=mounted("-o", "size=4k"), env={"TMPDIR": "mounted"}, says="space"),
    place("cache of 4 kB", make=mounted("-o", "size=4k"), env={"LINKPLAN_CACHE": "mounted"}, codes=(0,)),
    place("report over an earlier one on a full disk", "report", "planned", "-o", "mounted/r.html", codes=(2,),
          make=lambda f: (mounted("-o", "size=128k")(f), (f / "mounted/r.html").write_text('<meta name="generator" content="linkplan">mine')),
          after=lambda f: "" if (f / "mounted/r.html").read_text().endswith("mine") else "the earlier report is lost"),
    place("schema over an earlier one on a full disk", "schema", "-o", "mounted/s.json", codes=(2,),
          make=lambda f: (mounted("-o", "size=20k")(f), (f / "mounted/s.json").write_text(subprocess.run([sys.executable, "-m", "linkplan", "schema", "batch"], capture_output=True, text=True).stdout)),
          after=lambda f: "" if (f / "mounted/s.json").read_text().endswith("}\n") else "the earlier schema is lost"),
    failing("fsync", errno.EIO), failing("fsync", errno.EIO, from_call=5), failing("fsync", errno.ENOSPC, from_call=7), failing("fsync", errno.EIO, from_call=8, codes=(0, 2)),
    failing("fsync", errno.EINVAL, codes=(0, 2)), failing("fsync", errno.EIO, words=("export", "planned", "--to", "csv", "-o", "x.csv")),
    failing("fsync", errno.EIO, words=("render", "planned", "--size-px", "64x64", "-o", "x.png")),
    failing("fsync", errno.EIO, words=("track", "planned", "-o", "out")),
    failing("renameat2", errno.EIO), failing("renameat2", errno.ENOSYS, codes=(0,)), failing("renameat2", errno.EPERM, codes=(0,)), failing("renameat2", errno.EINVAL, codes=(0,)),
    failing("rename", errno.EIO), failing("rename", errno.EXDEV), failing("rename", errno.EACCES, from_call=1, codes=(0, 2)), failing("rename", errno.EIO, from_call=2, codes=(0, 2)),
    failing("link", errno.EPERM, codes=(0,)), failing("link", errno.EMLINK, codes=(0,)), failing("link", errno.EPERM, words=("export", "planned", "--to", "csv", "-o", "x.csv"), codes=(0,)),
    failing("flock", errno.ENOLCK, codes=(0, 2)), failing("flock", errno.EINVAL, codes=(0, 2)), failing("flock", errno.EWOULDBLOCK, codes=(0, 2)),
    failing("unlink", errno.EACCES, codes=(0, 2)), failing("unlink", errno.EIO, from_call=3, codes=(0, 2)), failing("rmdir", errno.EBUSY, codes=(0, 2)),
    failing("chmod", errno.EPERM, codes=(0, 2)), failing("mkdir", errno.ENOSPC), failing("mkdir", errno.EMLINK, from_call=1), failing("mkdir", errno.EDQUOT),
    failing("close", errno.EIO, from_call=400, codes=(0, 2)),
)
LIMITS = (
    *(limited("file size", resource.RLIMIT_FSIZE, most, make=earlier, changes=("out/",), codes=(2,)) for most in (0, 100, 3000, 30_000)),
    limited("file size", resource.RLIMIT_FSIZE, 1000, "report", "planned", "-o", "r.html", codes=(2,)),
    limited("file size", resource.RLIMIT_FSIZE, 1000, "export", "planned", "--to", "parquet", "-o", "x.parquet", codes=(2,)),
    limited("file size", resource.RLIMIT_FSIZE, 100, "export", "planned", "--to", "mat", "-o", "x.mat", codes=(2,)),
    limited("file size", resource.RLIMIT_FSIZE, 100, "render", "planned", "--size-px", "64x64", "-o", "x.mp4", codes=(2,)),
    limited("file size", resource.RLIMIT_FSIZE, 100, "render", "planned", "--size-px", "64x64", "-o", "x.gif", codes=(2,)),
    limited("file size", resource.RLIMIT_FSIZE, 100, "list", codes=(0, 2)),
    limited("file size", resource.RLIMIT_FSIZE, 100, "experiment", "planned", "--samples", "2", "--trackers", "pd", codes=(2,)),
    *(limited("files", resource.RLIMIT_NOFILE, most) for most in (6, 10, 20, 64)),
    *(limited("files", resource.RLIMIT_NOFILE, 20, *words) for words in (TRACK, ("render", "planned", "--size-px", "64x64", "-o", "x.png"), ("experiment", "planned", "--samples", "4", "--trackers", "pd", "-o", "out"), ("experiment", "planned", "--samples", "400", "--trackers", "pd", "--workers", "2", "-o", "out"), ("report", "planned", "-o", "r.html"))),
    *(limited("address space", resource.RLIMIT_AS, most * 1_000_000) for most in (150, 250, 350, 500, 1000, 3000)),
    *(limited("address space", resource.RLIMIT_AS, 3_000_000_000, *words) for words in (TRACK, ("compare", "planned"), ("bode", "optimus-knee", "--at-deg", "3.6", "--no-measure"), ("render", "planned", "--size-px", "64x64", "-o", "x.png"), ("experiment", "planned", "--samples", "4", "--trackers", "pd"), ("report", "planned", "-o", "r.html"))),
    *(limited("address space", resource.RLIMIT_AS, 700_000_000, *words) for words in (TRACK, ("render", "planned", "--size-px", "64x64", "-o", "x.png"), ("experiment", "planned", "--samples", "4", "--trackers", "pd"))),
    limited("data", resource.RLIMIT_DATA, 300_000_000), limited("data", resource.RLIMIT_DATA, 100_000_000),
    limited("processor time", resource.RLIMIT_CPU, 1, "bode", "optimus-knee", "-o", "out", codes=(-signal.SIGXCPU, -signal.SIGKILL, 0, 2)),
    limited("stack", resource.RLIMIT_STACK, 1_000_000), limited("stack", resource.RLIMIT_STACK, 300_000, codes=(0, 2)),
    limited("processes", resource.RLIMIT_NPROC, 1, unprivileged=True), limited("processes", resource.RLIMIT_NPROC, 1, *TRACK, unprivileged=True),
    limited("processes", resource.RLIMIT_NPROC, 1, "experiment", "planned", "--samples", "400", "--trackers", "pd", "--workers", "2", "-o", "out", unprivileged=True),
    limited("processes", resource.RLIMIT_NPROC, 1, "render", "planned", "--size-px", "64x64", "-o", "x.png", unprivileged=True),
    limited("processes", resource.RLIMIT_NPROC, 1, "plan", "knee-reach", "--set", "solver.compile=always", "-o", "out", unprivileged=True),
)
MEANWHILE = (
    place("that is gone before", make=lambda f: None, during=lambda f, p: None, codes=(0,)),
    place("whose folder is deleted while it runs", during=later(0.6, lambda f, _: shutil.rmtree(f)), codes=(0, 2), changes=("",)),
    place("whose folder is renamed while it runs", during=later(0.6, lambda f, _: (f.rename(f.with_name("moved")), time.sleep(3), f.with_name("moved").rename(f))), codes=(0, 2)),
    place("whose work folder is deleted while it runs", during=when_working(lambda f, w: shutil.rmtree(w, ignore_errors=True)), codes=(0, 2), make=earlier, changes=("out/",), after=whole),
    place("where a file comes while it runs", during=later(0.5, lambda f, _: (f / "out").write_text("mine")), codes=(2,), after=lambda f: "" if (f / "out").read_text() == "mine" else "lost"),
    place("where a folder comes while it runs", during=later(0.5, lambda f, _: ((f / "out").mkdir(), (f / "out/mine").write_text("mine"))), codes=(2,), after=lambda f: "" if (f / "out/mine").read_text() == "mine" else "lost"),
    place("where a link comes while it runs", during=later(0.5, lambda f, _: ((f / "other").mkdir(), (f / "out").symlink_to("other"))), codes=(0, 2)),
    place("of two at once", during=twice, codes=(0, 2), after=lambda f: (f / "second-went-wrong").read_text() if (f / "second-went-wrong").exists() else whole_new(f)),
    place("whose stdin is closed", closed=(0,), codes=(0,)), place("whose stdout is closed", closed=(1,), codes=(0,)), place("whose stderr is closed", closed=(2,), codes=(0,)),
    place("whose streams are closed", closed=(0, 1, 2), codes=(0,)), place("whose stdout is full", stdout="/dev/full", codes=(0,)),
    place("list whose stdout is full", "list", stdout="/dev/full"), place("list whose stdout is closed", "list", closed=(1,)), place("completion whose stdout is full", "completion", "bash", stdout="/dev/full"),
    place("schema whose stdout is full", "schema", stdout="/dev/full"), place("new whose stdout is full", "new", "optimus-knee", stdout="/dev/full"), place("help whose stdout is full", "--help", stdout="/dev/full", codes=(0, 2), lines=0),
    place("check --json whose stdout is full", "check", "optimus-knee", "--json", stdout="/dev/full"),
)


def whole_new(folder: Path) -> str:
    """Return what is wrong with a new result."""
    said = json.loads((folder / "out/.linkplan.json").read_text())
    return "".join(f"{name} lost; " for name in said["files"] if not (folder / "out" / name).is_file())


SURROUNDINGS = (
    with_env("C", LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"), with_env("POSIX", LC_ALL="POSIX", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0"),
    with_env("Turkish", LC_ALL="tr_TR.UTF-8"), with_env("no such locale", LC_ALL="xx_YY.EBCDIC", LANG="?"), with_env("ascii", PYTHONIOENCODING="ascii"), with_env("UTF-16", PYTHONIOENCODING="utf-16"),
    with_env("ascii list", "list", PYTHONIOENCODING="ascii:strict"), with_env("ascii help", "check", "--help", PYTHONIOENCODING="ascii:strict"),
    with_env("ascii check", "check", "optimus-knee", PYTHONIOENCODING="ascii:strict"), with_env("EBCDIC", "list", PYTHONIOENCODING="cp037"),
    with_env("dumb", TERM="dumb", COLUMNS="1"), with_env("one column", "--help", COLUMNS="1"), with_env("no columns", "plan", "--help", COLUMNS="0"), with_env("negative columns", "plan", "--help", COLUMNS="-5"), with_env("columns of words", "plan", "--help", COLUMNS="wide"),
    with_env("a billion columns", "--help", COLUMNS="999999999999999999999"), with_env("colours", FORCE_COLOR="1", CLICOLOR_FORCE="1"), with_env("no colours", NO_COLOR="1"),
    with_env("no home", HOME=None), with_env("home that is not there", HOME="/no/such"), with_env("home that is a device", HOME="/dev/null"), with_env("home that is nothing", HOME=""), with_env("home that is relative", HOME="."),
    with_env("no path", PATH=None), with_env("empty path", PATH=""), with_env("nothing at all", PATH=None, HOME=None, LANG=None, USER=None, LOGNAME=None, TERM=None, LINKPLAN_CACHE=None),
    with_env("temporary folder missing", TMPDIR="/no/such"), with_env("temporary folder is a device", TMPDIR="/dev/null"), with_env("temporary folder missing for an experiment", "experiment", "planned", "--samples", "2", "--trackers", "pd", TMPDIR="/no/such", codes=(0, 2)),
    with_env("cache is a file", LINKPLAN_CACHE="/etc/passwd"), with_env("cache is a device", LINKPLAN_CACHE="/dev/null"), with_env("cache is nothing", LINKPLAN_CACHE=""), with_env("cache is relative", LINKPLAN_CACHE="."), with_env("cache is /", LINKPLAN_CACHE="/"),
    with_env("cache is long", LINKPLAN_CACHE="/" + "x" * 5000), with_env("cache of words", LINKPLAN_CACHE_MB="many"), with_env("cache of nothing", LINKPLAN_CACHE_MB="0"), with_env("cache of nan", LINKPLAN_CACHE_MB="nan"), with_env("cache of -1", LINKPLAN_CACHE_MB="-1"),
    with_env("compiler that is none", "plan", "knee-reach", "--set", "solver.compile=always", CC="no-such-compiler"), with_env("compiler in quotes", "plan", "knee-reach", "--set", "solver.compile=always", CC='gcc "'), with_env("compiler that is a folder", "plan", "knee-reach", "--set", "solver.compile=always", CC="/"), with_env("compiler that prints", "plan", "knee-reach", "--set", "solver.compile=always", CC="echo"), with_env("compiler that is nothing", "plan", "knee-reach", "--set", "solver.compile=always", CC=""),
    with_env("threads of words", OMP_NUM_THREADS="many"), with_env("threads without end", OMP_NUM_THREADS="100000"), with_env("OpenGL of nothing", "render", "planned", "--size-px", "64x64", "-o", "x.png", MUJOCO_GL="nonsense", codes=(0, 2)), with_env("OpenGL disabled", "render", "planned", "--size-px", "64x64", "-o", "x.png", MUJOCO_GL="disable", codes=(0, 2)),
    with_env("OpenGL of glfw", "render", "planned", "--size-px", "64x64", "-o", "x.png", MUJOCO_GL="glfw", codes=(0, 2)), with_env("display that is none", "view", "planned", "--seconds", "1", DISPLAY=":77", codes=(2,)), with_env("no display", "view", "planned", "--seconds", "1", DISPLAY=None, WAYLAND_DISPLAY=None, codes=(2,)),
    with_env("backend of nothing", MPLBACKEND="nonsense"), with_env("backend of a window", MPLBACKEND="TkAgg"), with_env("matplotlib's folder is a device", MPLCONFIGDIR="/dev/null"), with_env("matplotlibrc is not there", MATPLOTLIBRC="/no/such"),
    with_env("warnings are errors", PYTHONWARNINGS="error"), with_env("warnings are errors: track", "track", "planned", "-o", "out", PYTHONWARNINGS="error"), with_env("warnings are errors: bode", "bode", "optimus-knee", "--at-deg", "3.6", "-o", "out", PYTHONWARNINGS="error"), with_env("warnings are errors: experiment", "experiment", "planned", "--samples", "4", "-o", "out", PYTHONWARNINGS="error"), with_env("warnings are errors: render", "render", "planned", "--size-px", "64x64", "-o", "x.gif", PYTHONWARNINGS="error"), with_env("warnings are errors: export", "export", "planned", "--to", "parquet", "-o", "x.parquet", PYTHONWARNINGS="error"),
    with_env("warnings are errors: check", "check", "optimus-knee", "-o", "out", PYTHONWARNINGS="error"), with_env("warnings are errors: report", "report", "planned", "-o", "r.html", PYTHONWARNINGS="error"), with_env("warnings are errors: compare", "compare", "planned", "-o", "out", PYTHONWARNINGS="error"), with_env("warnings are errors: decompose", "decompose", "planned", "-o", "out", PYTHONWARNINGS="error"),
    with_env("developer's Python", PYTHONDEVMODE="1"), with_env("optimized Python", PYTHONOPTIMIZE="2"), with_env("optimized Python: help", "track", "--help", PYTHONOPTIMIZE="2"), with_env("optimized Python: track", "track", "planned", PYTHONOPTIMIZE="2"), with_env("optimized Python: schema", "schema", PYTHONOPTIMIZE="2"), with_env("no bytecode", PYTHONDONTWRITEBYTECODE="1"), with_env("unbuffered", PYTHONUNBUFFERED="1"), with_env("safe path", PYTHONSAFEPATH="1"),
    with_env("malloc that fills", MALLOC_PERTURB_="165"), with_env("hash seed", PYTHONHASHSEED="0"), with_env("short integers", "plan", "knee-reach", "--set", "motion.duration_s=" + "9" * 700, PYTHONINTMAXSTRDIGITS="640", codes=(2,)),
    *(place(f"with a matplotlibrc of {name}", files={"matplotlibrc": text}, codes=(0,)) for name, text in {
        "TeX": "text.usetex: True\n", "no backend": "backend: nonsense\n", "huge pictures": "savefig.dpi: 30000\nfigure.dpi: 30000\n", "PDF": "savefig.format: pdf\n", "nonsense": "a: b\nfont.size: many\n\x00\n", "no font": "font.family: No Such Font\n", "Latin-1": "font.family: \xe9\n", "loud": "verbose.level: debug\n", "constrained": "figure.constrained_layout.use: True\nfigure.autolayout: True\n"}.items()),
)
PLACES = (*PERMISSIONS, *DISKS, *LIMITS, *MEANWHILE, *SURROUNDINGS)
