"""Hostile results: folders of experiments and batches, whole and unfinished, and reports, whose files were changed."""

# One case a line, of whatever length: a table.
# ruff: noqa: ARG005, E501
# fmt: off

import atexit
import functools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.bench.hostile import Case

# What may be resident [bytes]: files of megabytes that hold gigabytes are refused before they are decoded.
MOST_BYTES = 500_000_000
ASKED = ("knee-reach", "--set", "tracking.duration_s=0.01", "--samples", "6", "--trackers", "pd,pd+ff")
BATCH = 'problem = "knee-reach"\n[sweep]\nmotion.goal_deg.O = [-40, -39, -38]\n'
REPORT, AGAIN, SAMPLE = ("report", "exp", "-o", "r.html"), ("experiment", *ASKED, "-o", "exp"), ("track", "exp", "--sample", "3", "--tracker", "pd")
GO_ON, GO_ON_BATCH = ("experiment", *ASKED, "-o", "left"), ("batch", "b.toml", "-o", "swept")
# Ends a command before its result takes its place: its parts stay.
STOPPED = """
import sys
from linkplan.__main__ import main
from linkplan.studies.batch import study as batch
from linkplan.studies.experiment import study as experiment
if __name__ == "__main__":
    def stop(*_):
        raise KeyboardInterrupt
    batch.finish = experiment.finish = stop
    main()
"""
Change = Callable[[Path], object]


@functools.cache
def templates() -> Path:
    """Return a folder with an experiment, a tracked plan, and an experiment and a batch that are not finished."""
    place = Path(tempfile.mkdtemp(prefix="hostile-")).resolve()
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    (place / "b.toml").write_text(BATCH)
    for words in (("experiment", *ASKED, "-o", "exp"), ("track", "knee-reach", "-o", "tracked"), ("batch", "b.toml", "-o", "batched")):
        subprocess.run([sys.executable, "-m", "linkplan", *words], cwd=place, check=True, capture_output=True)
    for words in (GO_ON, GO_ON_BATCH):
        subprocess.run([sys.executable, "-c", STOPPED, *words], cwd=place, check=False, capture_output=True)
    return place


def case(name: str, change: Change, *words: str, **more) -> Case:
    def make(folder: Path) -> None:
        shutil.copytree(templates(), folder, dirs_exist_ok=True)
        asked = folder / "swept.unfinished/asked.json"  # the batch's plans are to stand here
        asked.write_text(asked.read_text().replace(str(templates() / "swept"), str(folder / "swept")))
        child = os.fork()  # what a process has held counts as held by those that it starts
        if not child:
            try:
                change(folder)
                os._exit(0)
            finally:
                os._exit(1)
        if os.waitpid(child, 0)[1]:
            raise ValueError(name)

    return Case(name=f"result {name}: {words[0]}", words=words, make=make, **{"most_bytes": MOST_BYTES, **more})


def write(path: str, content: str | tuple, head: str = "") -> Change:
    """Return what writes a text, or a beginning, a piece so and so many times, and an end."""
    def act(folder: Path) -> None:
        begin, piece, times, end = content if isinstance(content, tuple) else (content, "", 0, "")
        (folder / path).write_text(head + begin + piece * times + end)

    return act


def cut(path: str, share: float) -> Change:
    return lambda f: (f / path).write_bytes((f / path).read_bytes()[: int(share * (f / path).stat().st_size)])


def record(path: str, change: Callable[[dict], object]) -> Change:
    def act(folder: Path) -> None:
        said = json.loads((folder / path).read_text())
        change(said)
        (folder / path).write_text(json.dumps(said))

    return act


def instead(path: str, other: str) -> Change:
    """Return what puts another result's file in the place of one."""
    return lambda f: shutil.copyfile(f / other, f / path)


def replaced(path: str, act: Change) -> Change:
    return lambda f: ((f / path).unlink(), act(f / path))


def table(path: str, change: Callable, **how) -> Change:
    def act(folder: Path) -> None:
        from pyarrow import parquet

        parquet.write_table(change(parquet.read_table(folder / path)), folder / path, **how)

    return act


def column(name: str, change: Callable) -> Callable:
    def act(held):
        import pyarrow as pa

        place = held.schema.get_field_index(name)
        return held.set_column(place, name, pa.array(change(held[name].to_pylist()), held.schema.field(name).type))

    return act


def first(value: object) -> Callable[[list], list]:
    return lambda values: [value, *values[1:]]


def typed(name: str, kind: str) -> Callable:
    return lambda held: held.set_column(held.schema.get_field_index(name), name, held[name].cast(kind))


def nested(held):
    import pyarrow as pa

    deep: object = 1.0
    for _ in range(40):
        deep = [deep]
    return held.set_column(4, held.column_names[4], pa.array([deep] * held.num_rows))


def long_texts(held):
    return column("failure", lambda values: ["x" * 20_000_000 for _ in values])(held)


def rows(n: int, path: str = "exp/results.parquet") -> Change:
    """Return what makes a table of n rows that are all alike, which takes next to nothing on disk."""
    def act(folder: Path) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        schema, million = parquet.read_schema(folder / path), 1_000_000
        blank = {"int64": np.zeros(million, int), "double": np.zeros(million), "bool": np.ones(million, bool), "string": ["pd"] * million}
        block = pa.table({field.name: pa.array(blank[str(field.type)], field.type) for field in schema}, schema=schema)
        with parquet.ParquetWriter(folder / path, schema) as writer:
            for left in range(n, 0, -million):
                writer.write_table(block.slice(0, min(left, million)))

    return act


def many_columns(held):
    for k in range(3000):
        held = held.append_column(f"c{k}", held["chatter"])
    return held


def zipped(path: str, change: Callable[[dict[str, bytes]], dict[str, bytes]], *, squeeze: bool = False) -> Change:
    """Return what writes an archive's members again."""
    def act(folder: Path) -> None:
        with zipfile.ZipFile(folder / path) as archive:
            held = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(folder / path, "w", zipfile.ZIP_DEFLATED if squeeze else zipfile.ZIP_STORED) as archive:
            for name, data in change(held).items():
                archive.writestr(name, data)

    return act


def member(name: str, data: bytes | None) -> Callable[[dict[str, bytes]], dict[str, bytes]]:
    return lambda held: {key: value for key, value in (held | {name: data}).items() if value is not None}


def cases_said(change: Callable[[list], object]) -> Callable[[dict[str, bytes]], dict[str, bytes]]:
    def act(held: dict[str, bytes]) -> dict[str, bytes]:
        said = json.loads(held["cases.json"])
        change(said)
        return held | {"cases.json": json.dumps(said).encode()}

    return act


def lying(folder: Path) -> None:
    """Let an archive's directory say that a member is short whose bytes are a gigabyte of zeros."""
    path = folder / "swept.unfinished/parts/part-00000.zip"
    with zipfile.ZipFile(path) as archive:
        held = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in held.items():
            archive.writestr(name, bytes(1_000_000_000) if name.endswith(".csv") and name[0] == "1" else data)
        next(one for one in archive.filelist if one.filename == "1/trajectory.csv").file_size = 10


def arrays(path: str, **changes) -> Change:
    def act(folder: Path) -> None:
        with np.load(folder / path) as stored:
            held = dict(stored)
        np.savez_compressed(folder / path, **{name: changes.get(name, lambda a: a)(value) for name, value in held.items()})

    return act


def finer(n: int) -> dict[str, Callable]:
    """Return what makes n intervals of a motion: of the same coefficients each."""
    same = dict.fromkeys(("position", "velocity", "effort"), lambda a: np.ones((len(a), n, 1)))
    return {"breaks_s": lambda a: np.linspace(0, a[-1], n + 1), **same}


def special(path: str, *words: str) -> tuple[Case, ...]:
    """Return cases with what is no regular file in the place of one."""
    return tuple(case(f"{path} {name}", replaced(path, act), *words) for name, act in (
        ("a pipe", os.mkfifo), ("a device", lambda p: os.symlink("/dev/zero", p)), ("a folder", lambda p: p.mkdir()), ("a link to itself", lambda p: os.symlink(p.name, p)), ("missing", lambda p: None), ("sparse, of 10 GB", lambda p: (p.touch(), os.truncate(p, 10_000_000_000))))
    )


RESULTS, PART, ZIP = "exp/results.parquet", "left.unfinished/parts/part-00000.parquet", "swept.unfinished/parts/part-00000.zip"
TABLES = (
    *(case(f"table of {n} rows", rows(n), *words) for n in (1_000_000, 30_000_000) for words in (REPORT, AGAIN)),
    case("table of 30000000 rows beside", rows(30_000_000), *SAMPLE, codes=(0, 1)), case("table of 30000000 rows beside", rows(30_000_000), "decompose", "exp/plan", "--samples", "2", "--trackers", "pd", codes=(0, 1)),
    case("part of 30000000 rows", rows(30_000_000, PART), *GO_ON),
    *(case(f"table with {name}", table(RESULTS, change), *words) for words in (REPORT, AGAIN) for name, change in (
        ("a column renamed", lambda t: t.rename_columns([c.replace("rms_error", "error") for c in t.column_names])), ("a column left out", lambda t: t.drop_columns(["tracker"])), ("3000 columns more", many_columns), ("columns turned round", lambda t: t.select(t.column_names[::-1])),
        ("integers for numbers", typed("peak_effort", "float16")), ("texts for numbers", typed("rms_error_deg", "string")), ("bytes for texts", typed("tracker", "binary")), ("32 bits of sample", typed("sample", "int32")), ("lists of lists", nested),
        ("no rows", lambda t: t.slice(0, 0)), ("a row less", lambda t: t.slice(1)), ("rows turned round", lambda t: t.take(list(range(t.num_rows))[::-1])),
        ("sample 10^18", column("sample", first(10**18))), ("sample -1", column("sample", first(-1))), ("an unknown tracker", column("tracker", first("x\x1b[2J"))), ("a null tracker", column("tracker", first(None))),
        ("NaN", column("rms_error_deg", first(float("nan")))), ("null", column("max_error_deg", first(None))), ("a negative error", column("final_error_deg", first(-1.0))), ("a failed success", column("failure", first("fell"))), ("another machine", column("imperfection.delay_periods", first(9.0))), ("texts of 20 MB", long_texts))),
    *(case(f"table in {name}", table(RESULTS, lambda t: t, **how), *REPORT) for name, how in (("zstd", {"compression": "zstd"}), ("gzip", {"compression": "gzip"}), ("brotli", {"compression": "brotli"}), ("deltas", {"use_dictionary": False, "column_encoding": {"failure": "DELTA_BYTE_ARRAY"}}))),
    *(case(f"table cut to {share}", cut(RESULTS, share), *REPORT) for share in (0.0, 0.001, 0.5, 0.9, 0.999)), *(case(f"part cut to {share}", cut(PART, share), *GO_ON) for share in (0.0, 0.5, 0.999)),
    *(case(f"part with {name}", table(PART, change), *GO_ON) for name, change in (("a column left out", lambda t: t.drop_columns(["chatter"])), ("texts for numbers", typed("chatter", "string")), ("no rows", lambda t: t.slice(0, 0)), ("another sample", column("sample", first(77))), ("texts of 20 MB", long_texts))),
    *special(RESULTS, *REPORT), *special("exp/experiment.json", *SAMPLE)[:4], *special("exp/plan/trajectory.npz", *SAMPLE), *special("exp/plan/plan.json", *REPORT), *special("left.unfinished/asked.json", *GO_ON)[:4], *special("left.unfinished/plan/plan.json", *GO_ON), *special(ZIP, *GO_ON_BATCH)[:4],
)
SETTINGS = (
    ("no settings", lambda a: a.pop("settings")), ("settings of a list", lambda a: a.update(settings=[])), ("a tracker of numbers", lambda a: a["settings"].update(trackers=[5])), ("an unknown tracker", lambda a: a["settings"].update(trackers=["x"])), ("no trackers", lambda a: a["settings"].update(trackers=[])),
    ("-1 samples", lambda a: a["settings"].update(samples=-1)), ("10^9 samples", lambda a: a["settings"].update(samples=10**9)), ("10^30 samples", lambda a: a["settings"].update(samples=10**30)), ("a negative seed", lambda a: a["settings"].update(seed=-5)), ("a design of numbers", lambda a: a["settings"].update(design=7)),
    ("10^6 levels", lambda a: a["settings"].update(levels=10**6, design="grid")), ("1000 levels of a grid", lambda a: a["settings"].update(levels=1000, design="grid")), ("a tube of words", lambda a: a["settings"].update(tube_deg="x")), ("a negative tube", lambda a: a["settings"].update(tube_deg=-1)), ("format 7", lambda a: a.update(format=7)), ("a problem of lists", lambda a: a.update(problem=[])),
)
RECORDS = (
    *(case(f"record with {name}", record("exp/experiment.json", lambda said, change=change: change(said["asked"])), *words) for name, change in SETTINGS for words in (REPORT, SAMPLE)),
    *(case(f"record with {name}", record("exp/experiment.json", lambda said, change=change: change(said["asked"]["settings"])), *REPORT) for name, change in (("another seed", lambda s: s.update(seed=1)), ("7 samples", lambda s: s.update(samples=7)), ("a million samples", lambda s: s.update(samples=1_000_000)), ("another order", lambda s: s.update(trackers=["pd+ff", "pd"])), ("Morris' design", lambda s: s.update(design="morris")))),
    *(case(f"record that is {name}", write("exp/experiment.json", text), *words) for words in (REPORT, AGAIN) for name, text in (("empty", ""), ("cut", '{"asked": {"format": 1'), ("a list", "[]"), ("NaN", '{"asked": NaN}'), ("deep", "[" * 100_000), ("900 deep", '{"asked": {"format": 1, "plan": null, "settings": {}, "versions": {}, "problem": {"a": ' + "[" * 900 + "]" * 900 + "}}}"), ("of 8 MB of lists", ('{"asked": {"problem": {"a": [', "[],", 2_600_000, "1]}}}")), ("of 8 MB of tables", ('{"asked": {"problem": {"a": [', '{"":0},', 1_100_000, "1]}}}")), ("of 60 MB", ('{"asked": "', "x", 60_000_000, '"}')))),
    *(case(f"request that is {name}", write("left.unfinished/asked.json", text), *GO_ON) for name, text in (("empty", ""), ("a list", "[]"), ("deep", "[" * 100_000), ("another", '{"asked": 5}'), ("of 8 MB of tables", ('{"problem": [', '{"":0},', 1_100_000, "1]}")))),
    *(case(f"plan that is {name}", write("exp/plan/plan.json", text), *REPORT) for name, text in (("of 8 MB of tables", ('{"format": 1, "name": "", "status": "optimal", "message": "", "problem": {"a": [', '{"":0},', 1_100_000, "1]}}")), ("of 2 million solves", ('{"history": [', "{},", 2_000_000, "{}]}")), ("deep", "[" * 100_000))),
    *(case(f"plan with {name}", record("exp/plan/plan.json", change), *SAMPLE) for name, change in (("negative solves", lambda p: p["history"][0].update(intervals=-1)), ("no solver's time", lambda p: p["history"][0].pop("solve_s")), ("a status of numbers", lambda p: p.update(status=1)), ("an objective of words", lambda p: p.update(objective="x")), ("a message of lists", lambda p: p.update(message=[])), ("other imperfections", lambda p: p["problem"].update(imperfections={"x": 1})))),
    case("plan with other imperfections", record("exp/plan/plan.json", lambda p: p["problem"].update(imperfections={"delay_periods": [0.5, 2.5]})), *REPORT),
    *(case(f"motion with {name}", arrays("exp/plan/trajectory.npz", **changes), *SAMPLE, codes=(0, 1, 2)) for name, changes in (("single precision", {"effort": lambda a: a.astype(np.float32)}), ("bytes", {"effort": lambda a: np.zeros((3, 20_000_000, 1), np.uint8)}), ("NaN", {"effort": lambda a: a * np.nan}), ("a degree of 10000", {"position": lambda a: np.zeros((10_000, a.shape[1], 1))}), ("20000 intervals", finer(20_000)), ("20001 intervals", finer(20_001)), ("a million intervals", finer(1_000_000)), ("9 million breaks", {"breaks_s": lambda a: np.zeros(9_000_000)}), ("a period of numbers", {"periodic": lambda a: np.array(3.0)}))),
)
BATCHES = (
    *(case(f"block with {name}", zipped(ZIP, change), *GO_ON_BATCH) for name, change in (
        ("no cases", member("cases.json", None)), ("cases cut", member("cases.json", b"[{")), ("deep cases", member("cases.json", b"[" * 100_000)), ("a case less", cases_said(lambda c: c.pop())), ("a case renamed", cases_said(lambda c: c[0].update(name="../x"))), ("a row of numbers", cases_said(lambda c: c[0].update(row=5))), ("a record of words", cases_said(lambda c: c[0].update(record="x"))), ("a failure of lists", cases_said(lambda c: c[0].update(failure=[]))), ("a file that climbs", member("../../evil", b"x")), ("a file from the root", member(f"{tempfile.gettempdir()}/linkplan-evil-3", b"x")), ("a manifest", member("1/.linkplan.json", b"{}")), ("a plan cut", member("1/plan.json", b"{")), ("no plan", member("1/plan.json", None)), ("a motion cut", member("1/trajectory.npz", b"PK")), ("a motion of a plan", member("1/trajectory.npz", b"{}")), ("60,000 files", lambda held: held | {f"x{k}": b"" for k in range(60_000)}))),
    case("block with a bomb", zipped(ZIP, member("1/trajectory.csv", bytes(900_000_000)), squeeze=True), *GO_ON_BATCH), case("block whose size lies", lying, *GO_ON_BATCH), case("block cut", cut(ZIP, 0.5), *GO_ON_BATCH), case("block of nothing", write(ZIP, ""), *GO_ON_BATCH),
    *(case(f"batch that is {name}", write("batched/batch.json", text), "report", "batched", "-o", "r.html", codes=codes) for name, text, codes in (("empty", "", (2,)), ("a list", "[]", (2,)), ("of lists", '{"cases": []}', (2,)), ("of words", '{"cases": {"a": "b"}}', (2,)), ("of 60 MB that are skipped", ('{"cases": {"a": {"settings": [], "status": "x", "message": "", "more": [', "[],", 20_000_000, "1]}}}"), (0, 2)), ("of 60 MB of one case", ('{"cases": {', '"a": {"settings": [], "status": "x", "message": ""},', 1_000_000, '"b": {"settings": [], "status": "x", "message": ""}}}'), (0, 2)), ("NaN", '{"cases": {"a": {"objective": NaN}}}', (2,)))),
)
DOCUMENT, HEAD = "tracked/report.json", '{"title": "a", "verdict": "b", "versions": {}, "passed": null, "sections": '
DOCUMENTS = (
    *(case(f"document with {name}", write(DOCUMENT, text, HEAD), "report", "tracked", "-o", "r.html") for name, text in (
        ("sections of numbers", "[1]}"), ("a block of nothing", '[{"title": "", "blocks": [{}]}]}'), ("a block of an unknown kind", '[{"title": "", "blocks": [{"kind": "x"}]}]}'), ("a kind of lists", '[{"title": "", "blocks": [{"kind": []}]}]}'), ("deep sections", "[" * 100_000), ("a text of numbers", '[{"title": "", "blocks": [{"kind": "text", "text": 1}]}]}'), ("a deep cell", '[{"title": "", "blocks": [{"kind": "table", "title": "", "columns": [["", ""]], "rows": [[' + "[" * 80 + "]" * 80 + "]]}]}]}"), ("a short row", '[{"title": "", "blocks": [{"kind": "table", "title": "", "columns": [["", ""]], "rows": [[]]}]}]}'), ("a table of 8 MB", ('[{"title": "", "blocks": [{"kind": "table", "title": "", "columns": [], "rows": [', "[],", 2_600_000, "1]}]}]}")), ("numbers of 8 MB", ('[{"title": "", "blocks": [{"kind": "animation", "times": [', "1,", 3_900_000, "1]}]}]}")))),
    *(case(f"document cut to {share}", cut(DOCUMENT, share), "report", "tracked", "-o", "r.html") for share in (0.0, 0.5, 0.999)),
    *(case(f"document whose {kind} lack {name}", record(DOCUMENT, lambda said, kind=kind, name=name: [block.pop(name) for section in said["sections"] for block in section["blocks"] if block["kind"] == kind]), "report", "tracked", "-o", "r.html") for kind, name in (("plot", "series"), ("plot", "x"), ("animation", "bodies"), ("table", "rows"))),
)
EXCHANGED = tuple(
    case(f"{path} that is {other}", instead(path, other), *words) for path, other, words in (
        (RESULTS, "exp/experiment.json", REPORT), (RESULTS, "exp/plan/trajectory.npz", REPORT), (RESULTS, "exp/experiment.png", REPORT), (RESULTS, ZIP, AGAIN), ("exp/experiment.json", "exp/plan/plan.json", REPORT), ("exp/experiment.json", "batched/batch.json", AGAIN), ("exp/experiment.json", "tracked/report.json", SAMPLE), ("exp/experiment.json", RESULTS, SAMPLE),
        ("exp/plan/plan.json", "exp/experiment.json", REPORT), ("exp/plan/plan.json", "tracked/track.json", SAMPLE), ("exp/plan/trajectory.npz", RESULTS, REPORT), ("exp/plan/trajectory.npz", ZIP, SAMPLE), (DOCUMENT, "exp/experiment.json", ("report", "tracked", "-o", "r.html")), (DOCUMENT, "batched/batch.json", ("report", "tracked", "-o", "r.html")), ("batched/batch.json", "exp/experiment.json", ("report", "batched", "-o", "r.html")), ("batched/batch.json", "tracked/report.json", ("report", "batched", "-o", "r.html")), (ZIP, "exp/plan/trajectory.npz", GO_ON_BATCH), (ZIP, PART, GO_ON_BATCH), (PART, ZIP, GO_ON), ("left.unfinished/asked.json", "swept.unfinished/asked.json", GO_ON), ("swept.unfinished/asked.json", "left.unfinished/asked.json", GO_ON_BATCH))
)
# As they were: what is refused above is refused for what was changed.
ALONE = tuple(case("left alone", lambda _: None, *words, codes=(0, 1), changes=("left.", "swept.")) for words in (REPORT, AGAIN, SAMPLE, GO_ON, GO_ON_BATCH, ("report", "tracked", "-o", "r.html"), ("report", "batched", "-o", "r.html")))
RESULTS_CASES = (*ALONE, *TABLES, *RECORDS, *BATCHES, *DOCUMENTS, *EXCHANGED)
