"""Hostile results: saved plans and other folders of linkplan's that were changed, by hand or by accident."""

# One case a line, of whatever length: a table.
# ruff: noqa: ARG005, E501
# fmt: off

import io
import json
import os
import pickle
import shutil
import struct
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.bench.hostile import Case
from tests.bench.hostile_files import KNEE, REACH

# What is there once a file's code was run, or a name followed out of its folder.
EVIL = os.path.join(tempfile.gettempdir(), "linkplan-evil")


def record(**changes) -> Callable[[Path], None]:
    """Return what changes keys of a plan's record; a function is called with the value."""
    def make(folder: Path) -> None:
        path = folder / "planned" / "plan.json"
        said = json.loads(path.read_text())
        for name, value in changes.items():
            said[name] = value(said[name]) if callable(value) else value
        path.write_text(json.dumps(said))

    return make


def text(old: str, new: str, name: str = "plan.json") -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        path = folder / "planned" / name
        before = path.read_text()
        if old not in before:
            raise ValueError(old)
        path.write_bytes(before.replace(old, new, 1).encode("utf-8", "surrogatepass"))

    return make


def arrays(**changes) -> Callable[[Path], None]:
    """Return what changes a plan's arrays; a function is called with the array."""
    def make(folder: Path) -> None:
        path = folder / "planned" / "trajectory.npz"
        with np.load(path) as stored:
            held = dict(stored)
        for name, value in changes.items():
            held[name] = value(held[name]) if callable(value) else value
        np.savez(path, **{name: value for name, value in held.items() if value is not None})

    return make


def npz(act: Callable[[zipfile.ZipFile, dict[str, bytes]], None]) -> Callable[[Path], None]:
    """Return what writes a plan's arrays again, by hand."""
    def make(folder: Path) -> None:
        path = folder / "planned" / "trajectory.npz"
        with zipfile.ZipFile(path) as archive:
            held = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w") as archive:
            act(archive, held)

    return make


def all_of(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    for name, data in held.items():
        archive.writestr(name, data)


def pickled(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    class Evil:
        def __reduce__(self):
            return os.system, (f"touch {EVIL}",)

    all_of(archive, {**held, "effort.npy": pickle.dumps(Evil())})


def objects(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    all_of(archive, {**held, "effort.npy": file.getvalue()})


def header(text: bytes) -> Callable[[zipfile.ZipFile, dict[str, bytes]], None]:
    """Return what gives the efforts another header."""
    def act(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
        all_of(archive, {**held, "effort.npy": b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + b"\0" * 64})

    return act


def twice(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    all_of(archive, held)
    archive.writestr("effort.npy", held["effort.npy"][:-8] + struct.pack("<d", 1e9))


def climbing(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    all_of(archive, {**held, "../../evil.npy": b"x", f"{EVIL}-2": b"x"})


def squeezed(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    all_of(archive, {k: v for k, v in held.items() if k != "effort.npy"})
    archive.writestr("effort.npy", b"\x93NUMPY\x01\x00" + b"\0" * 500_000_000, compress_type=zipfile.ZIP_DEFLATED)


def lying(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    all_of(archive, held)
    archive.getinfo("effort.npy").file_size = 10


def many(archive: zipfile.ZipFile, held: dict[str, bytes]) -> None:
    all_of(archive, held)
    for k in range(60_000):
        archive.writestr(f"x{k}", b"")


def of_own_model(change: Callable[[Path], None]) -> Callable[[Path], None]:
    """Return what plans with a model of one's own, then changes that."""
    def make(folder: Path) -> None:
        import subprocess
        import sys

        (folder / "m.xml").write_text(KNEE)
        (folder / "p.toml").write_text(REACH.replace('"optimus-knee"', '"m.xml"'))
        shutil.rmtree(folder / "planned")
        subprocess.run([sys.executable, "-m", "linkplan", "plan", "p.toml", "-o", "planned"], cwd=folder, check=True, capture_output=True)
        change(folder)

    return make


def edited(old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / "m.xml").read_text()
        if old not in text:
            raise ValueError(old)
        (folder / "m.xml").write_text(text.replace(old, new))

    return change


def replaced(act: Callable[[Path], None], name: str = "m.xml") -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        (folder / name).unlink()
        act(folder / name)

    return change


def result(name: str, said: object) -> Callable[[Path], None]:
    """Return what makes a folder that holds nothing but a record."""
    def make(folder: Path) -> None:
        (folder / "r").mkdir()
        (folder / "r" / name).write_text(said if isinstance(said, str) else json.dumps(said))

    return make


def plan(name: str, make, *words: str, **more) -> Case:
    return Case(name=f"saved {name}", words=words or ("track", "planned"), make=make, **{"codes": (1, 2), **more})


def report(name: str, make, **more) -> Case:
    return Case(name=f"report of {name}", words=("report", "r"), make=make, **{"codes": (0, 2), **more})


def unscripted(folder: Path) -> str:
    page = (folder / "report.html")
    return "a script in the page" if page.exists() and "<script>alert" in page.read_text() else ""


EVIL = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
RECORDS = (
    plan("with a key twice", text('"status": "optimal"', '"status": "failed", "status": "optimal"'), codes=(0, 1, 2)),
    plan("with NaN", text('"objective": ', '"objective": NaN, "x": '), codes=(0, 1, 2)),
    plan("with infinity", text('"objective": ', '"objective": Infinity, "x": '), codes=(0, 1, 2)),
    plan("with 1e999", text('"objective": ', '"objective": 1e999, "x": '), codes=(0, 1, 2)),
    plan("with a huge integer", text('"objective": ', f'"objective": {"9" * 4000}, "x": '), codes=(0, 1, 2)),
    plan("with an integer of 10,000 digits", text('"objective": ', f'"objective": {"9" * 10000}, "x": ')),
    plan("with a mark of byte order", lambda f: (f / "planned/plan.json").write_bytes(b"\xef\xbb\xbf" + (f / "planned/plan.json").read_bytes()), codes=(0, 2)),
    plan("in UTF-16", lambda f: (f / "planned/plan.json").write_text((f / "planned/plan.json").read_text(), encoding="utf-16")),
    plan("nested deeply", lambda f: (f / "planned/plan.json").write_text("[" * 100_000)),
    plan("nested 900 deep", record(problem={"motion": json.loads("[" * 400 + "]" * 400)})),
    plan("that is a list", lambda f: (f / "planned/plan.json").write_text("[]")),
    plan("that is null", lambda f: (f / "planned/plan.json").write_text("null")),
    plan("that is empty", lambda f: (f / "planned/plan.json").write_text("")),
    plan("whose record is a folder", lambda f: ((f / "planned/plan.json").unlink(), (f / "planned/plan.json").mkdir())),
    plan("whose record is a pipe", lambda f: ((f / "planned/plan.json").unlink(), os.mkfifo(f / "planned/plan.json"))),
    plan("whose record is a link to itself", lambda f: ((f / "planned/plan.json").unlink(), os.symlink("plan.json", f / "planned/plan.json"))),
    plan("whose record is a device", lambda f: ((f / "planned/plan.json").unlink(), os.symlink("/dev/zero", f / "planned/plan.json"))),
    plan("of format 1.0", record(format=1.0), codes=(0, 2)), plan("of format true", record(format=True), codes=(0, 2)), plan("of format 2", record(format=2)),
    plan("of format '1'", record(format="1")), plan("of a status of lists", record(status=["optimal"])), plan("of a status of tables", record(status={})),
    plan("of a problem of lists", record(problem=[])), plan("of an empty problem", record(problem={})),
    plan("with details of lists", record(details=[1])), plan("with details of NaN", record(details={"a": float("nan")})),
    plan("with a history of nonsense", record(history=[{"objective": "x"}])), plan("with a history of null", record(history=None)),
    plan("with a history of huge numbers", record(history=lambda h: [{**row, "build_s": 1e300, "intervals": -5, "objective": "nan"} for row in h]), "report", "planned"),
    plan("with a history of words", record(history=lambda h: [dict.fromkeys(row, "x") for row in h]), "report", "planned", codes=(0, 2)),
    plan("with versions of lists", record(versions=[1]), codes=(0, 1, 2)), plan("with versions of numbers", record(versions={"mujoco": 4})),
    plan("with a fingerprint of lists", record(fingerprint=[1])), plan("with a fingerprint of numbers", record(fingerprint={"bodies": 1}), codes=(0, 2)),
    plan("with a model from a device", record(model_from_here="/dev/zero"), codes=(0, 2)), plan("with a model from above", record(model_from_here="../../../../etc/passwd"), codes=(0, 2)),
    plan("with a model from a zero byte", record(model_from_here="a\0b"), codes=(0, 2)), plan("with a model from numbers", record(model_from_here=5)),
    plan("with a name of numbers", record(name=5)), plan("with a name of a lone surrogate", text('"name": "knee-reach"', '"name": "\\ud800"'), codes=(0, 2)),
    plan("with a name of a lone surrogate, in a report", text('"name": "knee-reach"', '"name": "\\ud800"'), "report", "planned", codes=(0, 2)),
    plan("with a name of a lone surrogate, exported", text('"name": "knee-reach"', '"name": "\\ud800"'), "export", "planned", "--to", "mat", "-o", "x.mat", codes=(0, 2)),
    plan("with a name of a lone surrogate, as Parquet", text('"name": "knee-reach"', '"name": "\\ud800"'), "export", "planned", "--to", "parquet", "-o", "x.parquet", codes=(0, 2)),
    plan("with a name of a lone surrogate, as keyframes", text('"name": "knee-reach"', '"name": "\\ud800"'), "export", "planned", "--to", "keyframes", "-o", "x.xml", codes=(0, 2)),
    plan("with a name of a lone surrogate, saved", text('"name": "knee-reach"', '"name": "\\ud800"'), "track", "planned", "-o", "out", "--report", "--parquet", codes=(0, 2)),
    plan("with a name of a lone surrogate, drawn", text('"name": "knee-reach"', '"name": "\\ud800"'), "compare", "planned", "-o", "out", codes=(0, 2)),
    plan("with a name of a lone surrogate, in an experiment", text('"name": "knee-reach"', '"name": "\\ud800"'), "experiment", "planned", "--samples", "2", "--trackers", "pd", "-o", "out", codes=(0, 2)),
    plan("with a name of a lone surrogate, split", text('"name": "knee-reach"', '"name": "\\ud800"'), "decompose", "planned", "--trackers", "pd", "-o", "out", codes=(0, 2)),
    plan("with a name of a lone surrogate, filmed", text('"name": "knee-reach"', '"name": "\\ud800"'), "render", "planned", "--size-px", "64x64", "-o", "x.mp4", codes=(0, 2)),
    plan("with a name of 1 MB", record(name="x" * 1_000_000), "track", "planned", "-o", "out", codes=(0, 2)),
    plan("with a name of lines", record(name="a\nb\r\x1b[2J\t"), "track", "planned", "-o", "out", codes=(0, 2)),
    plan("with a name of zero bytes", record(name="a\0b"), "track", "planned", "-o", "out", codes=(0, 2)),
    plan("with a name of a formula", record(name="=1+1"), "export", "planned", "--to", "csv", "-o", "x.csv", codes=(0,)),
    plan("with a name of mathtext", record(name="$\\frac{$"), "compare", "planned", "-o", "out", codes=(0,)),
    plan("with a message of control characters", record(status="failed", message="\x1b[2J\x07bad\nlinkplan: all is well"), codes=(1,)),
    plan("with a name of HTML", record(name=EVIL), "report", "planned", codes=(0,), after=unscripted),
    plan("with notes of HTML", record(notes=[EVIL], message=EVIL), "report", "planned", codes=(0,), after=unscripted),
    plan("with notes of numbers", record(notes=5), "report", "planned", codes=(0,)),
    plan("with a guess that is gone", record(problem=lambda p: {**p, "guess": {"plan": "/no/such"}}), codes=(0,)),
    plan("with a guess that is itself", record(problem=lambda p: {**p, "guess": {"plan": "planned"}}), codes=(0, 2)),
    plan("with limits of null", record(problem=lambda p: {**p, "limits": {"effort": {"act_O": [None, None]}}}), codes=(0, 1, 2)),
    plan("with an actuator's limit of null", record(problem=lambda p: {**p, "limits": None})),
    plan("with unknown tables", record(problem=lambda p: {**p, "x": {}})),
    plan("with a tracking that has gone", record(problem=lambda p: {**p, "tracking": {"period_s": 1e-7}}), "track", "planned", codes=(0, 1, 2)),
    plan("with an own manifest that climbs", lambda f: (f / "planned/.linkplan.json").write_text(json.dumps({"format": 1, "record": "plan.json", "identity": "x", "files": ["../p.toml"]})), "plan", "knee-reach", "-o", "planned", files={"p.toml": "mine"}),
    plan("with an own manifest of links", lambda f: ((f / "planned/.linkplan.json").unlink(), os.symlink("/etc/passwd", f / "planned/.linkplan.json")), "plan", "knee-reach", "-o", "planned"),
    plan("with an own manifest that is a pipe", lambda f: ((f / "planned/.linkplan.json").unlink(), os.mkfifo(f / "planned/.linkplan.json")), "plan", "knee-reach", "-o", "planned"),
    plan("with an own manifest that lists the user's", lambda f: ((f / "planned/mine.txt").write_text("mine"), text('"plan.json",', '"plan.json", "mine.txt/x",', ".linkplan.json")(f)), "plan", "knee-reach", "-o", "planned", codes=(0, 2), changes=("planned/plan", "planned/traj", "planned/.link")),
    plan("with a link in the place of a file", lambda f: ((f / "planned/plan.png").unlink(), (f / "thesis").write_text("mine"), os.symlink("../thesis", f / "planned/plan.png")), "plan", "knee-reach", "-o", "planned", codes=(0, 2), changes=("planned/",)),
    plan("with a folder in the place of a file", lambda f: ((f / "planned/plan.png").unlink(), (f / "planned/plan.png").mkdir(), (f / "planned/plan.png/mine").write_text("mine")), "plan", "knee-reach", "-o", "planned", codes=(0, 2), changes=("planned/plan.json", "planned/traj", "planned/.link")),
    plan("asked to be compared into itself", lambda f: None, "compare", "planned", "-o", "planned"), plan("asked to be tracked into itself", lambda f: None, "track", "planned", "-o", "planned/../planned"),
    plan("asked to be tracked inside itself", lambda f: None, "track", "planned", "-o", "planned/x", codes=(0,)), plan("asked by a link", lambda f: os.symlink("planned", f / "l"), "track", "l", codes=(0,)), plan("asked by its record", lambda f: None, "track", "planned/plan.json"), plan("asked by its motion", lambda f: None, "check", "planned/trajectory.npz"),
)
MOTIONS = (
    plan("with a pickle", npz(pickled), after=lambda f: "it was run" if os.path.exists(EVIL) else ""), plan("with objects", npz(objects)), plan("with a member twice", npz(twice), codes=(0, 1, 2)), plan("with members that climb", npz(climbing), codes=(0,), after=lambda f: "evil" if os.path.exists(f"{EVIL}-2") else ""),
    plan("with a bomb", npz(squeezed)), plan("with a size that lies", npz(lying), codes=(0, 1, 2)), plan("with 60,000 members", npz(many), codes=(0, 2)),
    plan("with a header of code", npz(header(f"__import__('os').system('touch {EVIL}')\n".encode()))), plan("with a header of parentheses", npz(header(b"(" * 60_000))), plan("with a header of a negative shape", npz(header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}\n"))),
    plan("with a header of a huge shape", npz(header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (2**62,)}\n"))), plan("with a header of huge shapes", npz(header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999, 99999999999999999999)}\n"))), plan("with a header of no bytes", npz(header(b"{'descr': '<V0', 'fortran_order': False, 'shape': (9999999999,)}\n"))),
    plan("with a header of a shape of words", npz(header(b"{'descr': '<f8', 'fortran_order': False, 'shape': ('a',)}\n"))), plan("with a header of a record", npz(header(b"{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (8,)}\n"))), plan("with a header of true shapes", npz(header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (True, 8)}\n"))),
    plan("of NaN", arrays(effort=lambda a: a * np.nan)), plan("of infinity", arrays(velocity=lambda a: a + np.inf)), plan("of 1e300", arrays(position=lambda a: a * 1e300)), plan("of 1e200 in effort", arrays(effort=lambda a: a * 1e200)), plan("of tiny time", arrays(breaks_s=lambda a: a * 1e-200)), plan("of huge time", arrays(breaks_s=lambda a: a * 1e200)), plan("of time that goes back", arrays(breaks_s=lambda a: a[::-1])), plan("of time that stands", arrays(breaks_s=lambda a: a * 0)), plan("of two days", arrays(breaks_s=lambda a: a * 1e6)),
    plan("of no intervals", arrays(breaks_s=lambda a: a[:1])), plan("of no time", arrays(breaks_s=np.zeros(0))), plan("of few positions", arrays(position=lambda a: a[:1])), plan("of few nodes", arrays(position=lambda a: a[:, :1])), plan("of no nodes", arrays(position=lambda a: a[:, :0])), plan("of no efforts", arrays(effort=lambda a: a[..., :0])), plan("of two efforts", arrays(effort=lambda a: np.concatenate([a, a], axis=-1))), plan("of no pose", arrays(start_pose=np.zeros(0))), plan("of a pose far away", arrays(start_pose=lambda a: a + 100)), plan("of a pose of NaN", arrays(start_pose=lambda a: a * np.nan)), plan("of a pose of 1e300", arrays(start_pose=lambda a: a * 1e300)),
    plan("of a flat motion", arrays(position=lambda a: a.ravel())), plan("of a motion of four axes", arrays(position=lambda a: a[None])), plan("of integers", arrays(position=lambda a: a.astype(int))), plan("of booleans", arrays(position=lambda a: a > 0)), plan("of halves", arrays(position=lambda a: a.astype(np.float16))), plan("of long doubles", arrays(position=lambda a: a.astype(np.longdouble)), codes=(0, 1, 2)), plan("of the other end first", arrays(position=lambda a: a.astype(">f8")), codes=(0, 1, 2)), plan("of complex numbers", arrays(position=lambda a: a + 1j)), plan("of words", arrays(position=np.array(["a"]))), plan("of dates", arrays(position=np.array(["2020-01-01"], dtype="M8[D]"))), plan("in Fortran's order", arrays(position=np.asfortranarray), codes=(0,)), plan("periodic of words", arrays(periodic=np.array("x"))), plan("periodic of three", arrays(periodic=np.array([True, False, True]))), plan("periodic", arrays(periodic=np.array(True))), plan("periodic of NaN", arrays(periodic=np.array(np.nan)), codes=(0, 1, 2)), plan("without efforts", arrays(effort=None)), plan("with one more array", arrays(x=np.zeros(3)), codes=(0,)), plan("with 20,000 nodes in an interval", arrays(position=lambda a: np.repeat(a, 5000, axis=1))), plan("with 30,000 intervals", arrays(breaks_s=np.linspace(0, 0.16, 30_001), position=lambda a: np.repeat(a[:1], 30_000, axis=0), velocity=lambda a: np.repeat(a[:1], 30_000, axis=0), effort=lambda a: np.repeat(a[:1], 30_000, axis=0))),
    plan("whose motion is a folder", lambda f: ((f / "planned/trajectory.npz").unlink(), (f / "planned/trajectory.npz").mkdir())), plan("whose motion is missing", lambda f: (f / "planned/trajectory.npz").unlink()), plan("whose motion is an npy", lambda f: np.save((f / "planned/trajectory.npz").open("wb"), np.zeros(3))), plan("whose motion is a zip of nothing", lambda f: zipfile.ZipFile(f / "planned/trajectory.npz", "w").close()),
)
MODELS = (
    plan("whose model is lighter now", of_own_model(edited('density="1000"', 'density="900"')), says="changed"), plan("whose model is weaker now", of_own_model(edited('ctrlrange="-100 100"', 'ctrlrange="-10 10"')), codes=(1, 2)), plan("whose model has other names now", of_own_model(edited('"O"', '"P"'))), plan("whose model has another step now", of_own_model(edited('timestep="0.0001"', 'timestep="0.001"')), codes=(0, 1, 2)), plan("whose model's colours are other now", of_own_model(edited('rgba="0.84 0.37 0.00 1"', 'rgba="1 0 0 1"')), codes=(0,)),
    plan("whose model is gone", of_own_model(lambda f: (f / "m.xml").unlink())), plan("whose model is a folder now", of_own_model(replaced(lambda p: p.mkdir()))), plan("whose model is a pipe now", of_own_model(replaced(os.mkfifo))), plan("whose model is a device now", of_own_model(replaced(lambda p: os.symlink("/dev/zero", p)))), plan("whose model is empty now", of_own_model(replaced(lambda p: p.write_text("")))), plan("whose model is another now", of_own_model(replaced(lambda p: p.write_text("<mujoco/>")))), plan("whose model is a link in a circle now", of_own_model(replaced(lambda p: os.symlink("m.xml", p)))),
    plan("whose model is gone, in a report", of_own_model(lambda f: (f / "m.xml").unlink()), "report", "planned"), plan("that was moved with its model", of_own_model(lambda f: ((f / "d").mkdir(), shutil.move(f / "planned", f / "d/planned"), shutil.move(f / "m.xml", f / "d/m.xml"))), "track", "d/planned", codes=(0,)),
)
REPORTS = (
    *(report(f"{name} of HTML", result(name, {key: {EVIL: EVIL}, "message": EVIL, "mechanism": EVIL, EVIL: [{EVIL: EVIL}]}), after=unscripted) for name, key in (("track.json", "tracker"), ("compare.json", "plan"), ("bode.json", "points"), ("tune.json", "found"), ("check.json", "problems"), ("demo.json", "versions"), ("batch.json", "cases"), ("decompose.json", "decomposition"))),
    *(report(f"{name} of experiments", result("experiment.json", said)) for name, said in (("nothing", {}), ("a list", []), ("words", {"experiment": "x"}), ("nonsense", {"experiment": {"settings": {"trackers": 5}}, "summary": [1]}), ("NaN", '{"experiment": NaN}'))),
    report("numbers without end", result("bode.json", '{"points": [{"a": 1e999, "b": NaN, "c": -Infinity}], "x": NaN}')), report("a lone surrogate", result("bode.json", '{"points": 1, "message": "\\ud800", "mechanism": "\\udfff"}')), report("a deep record", result("bode.json", '{"points": ' + "[" * 50_000 + "]" * 50_000 + "}")), report("a record of a million rows", result("bode.json", {"points": [{"a": k} for k in range(300_000)]})), report("a record of many columns", result("bode.json", {"points": [{f"a{k}": k} for k in range(20_000)]})), report("an integer of 5000 digits", result("bode.json", '{"points": ' + "9" * 5000 + "}")), report("an integer of 4000 digits", result("bode.json", '{"points": ' + "9" * 4000 + "}")),
    *(report(f"a document of {name}", result("report.json", said), after=unscripted) for name, said in (
        ("HTML", {"title": EVIL, "verdict": EVIL, "versions": {EVIL: EVIL}, "passed": True, "sections": [{"title": EVIL, "blocks": [{"kind": EVIL, "text": EVIL}, {"kind": "Text", "text": EVIL}]}]}), ("infinity", '{"title": "a", "verdict": "b", "versions": {}, "passed": null, "sections": [{"title": "x", "blocks": [{"kind": "x", "v": 1e999}]}]}'), ("NaN", '{"title": "a", "verdict": "b", "versions": {"x": NaN}, "passed": null, "sections": []}'), ("a lone surrogate", '{"title": "\\ud800", "verdict": "b", "versions": {}, "passed": null, "sections": []}'), ("braces", {"title": "{{document}}", "verdict": "{{program}}", "versions": {}, "passed": None, "sections": []}), ("passed 1", {"title": "a", "verdict": "b", "versions": {}, "passed": 1, "sections": []}), ("passed of lists", {"title": "a", "verdict": "b", "versions": {}, "passed": [], "sections": []}), ("depth", '{"title": "a", "verdict": "b", "versions": {}, "passed": null, "sections": [], "x": ' + "[" * 900 + "]" * 900 + "}"), ("great depth", '{"title": "a", "verdict": "b", "versions": {}, "passed": null, "sections": [], "x": ' + "[" * 50_000 + "]" * 50_000 + "}"), ("an integer of 5000 digits", '{"title": "a", "verdict": "b", "versions": {}, "passed": null, "sections": [], "x": ' + "9" * 5000 + "}"))),
    *(Case(name=f"report into {name}", words=("report", "planned", "-o", target), make=make, codes=codes) for name, target, make, codes in (
        ("a pipe", "p", lambda f: os.mkfifo(f / "p"), (2,)), ("a device", "/dev/zero", lambda f: None, (2,)), ("nothing", "/dev/null", lambda f: None, (2,)), ("stdout", "/dev/stdout", lambda f: None, (2,)), ("a link in a circle", "l", lambda f: os.symlink("l", f / "l"), (2,)), ("a link to nowhere", "l", lambda f: os.symlink("no/such", f / "l"), (2,)), ("a link to a thesis", "l", lambda f: ((f / "t").write_text("mine"), os.symlink("t", f / "l")), (2,)), ("a folder that is not there", "a/b.html", lambda f: None, (2,)), ("a folder", ".", lambda f: None, (2,)), ("a file as folder", "f/x", lambda f: (f / "f").write_text("mine"), (2,)), ("a zip of 10 GB", "z", lambda f: os.truncate(os.open(f / "z", os.O_RDWR | os.O_CREAT), 10_000_000_000), (2,)), ("a long name", "x" * 300, lambda f: None, (2,)))),
)
PLANS = (*RECORDS, *MOTIONS, *MODELS, *REPORTS)
