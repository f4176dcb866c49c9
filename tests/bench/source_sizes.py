"""The sizes of the project. `make check` prints this table; no number in it fails the check.

    python -m tests.bench.source_sizes

A room is a folder of a package, or a file in the package's own folder. Named numbers stand at the top of a file; inline ones
inside of expressions, without indices and without 0, 1 and 2. The last columns are the arrows from one room to another that
begin in the row's files, and the imports behind them, file by file.
"""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from linkplan.studies.output.text import table
from tests.support.sources import PACKAGES, ROOT, SOURCES, arrows, inline_numbers, named_numbers

HEAD = ["", "files", "lines", "longest file", "named numbers", "inline numbers", "arrows", "imports"]
# The largest rooms are listed by themselves.
N_ROOMS = 12


def lines_of(path: Path) -> int:
    """Return the number of lines of a file."""
    return len(path.read_text(encoding="utf-8").splitlines())


def row(name: str, paths: Iterable[Path], outgoing: Counter) -> list:
    """Return the row of the table on some files, `outgoing` the imports that lead out of them by room."""
    paths = list(paths)
    lines = [lines_of(path) for path in paths]
    named = sum(len(named_numbers(path)) for path in paths)
    inline = sum(1 for path in paths for _ in inline_numbers(path))
    return [name, len(paths), sum(lines), max(lines, default=0), named, inline, len(outgoing), sum(outgoing.values())]


def outgoing(ends: Counter, package: str, room: str | None = None) -> Counter:
    """Return the imports that lead out of a room, or between all rooms of a package and out of it."""
    pairs = {pair: n for pair, n in ends.items() if pair[0][0] == package and room in (None, pair[0][1])}
    return Counter(pairs if room is None else {other: n for (_, other), n in pairs.items()})


def size_table() -> str:
    """Return the table: a row of each package and of all, of the tests, and of the largest rooms."""
    ends, by_room = arrows(), {}
    for path in SOURCES:
        package, place = path.relative_to(ROOT).parts[:2]
        by_room.setdefault((package, Path(place).stem), []).append(path)
    rows = [
        row(name, (p for (package, _), paths in by_room.items() if package == name for p in paths), outgoing(ends, name))
        for name in (*PACKAGES, "linkplan")
    ]
    rows.append(row("all", SOURCES, ends))
    tests = [lines_of(path) for path in (ROOT / "tests").rglob("*.py")]
    rows.append(["tests", len(tests), sum(tests), max(tests), *[None] * 4])
    largest = sorted(by_room, key=lambda room: -sum(map(lines_of, by_room[room])))[:N_ROOMS]
    rows += [row(".".join(room), by_room[room], outgoing(ends, *room)) for room in largest]
    return table(HEAD, rows)


if __name__ == "__main__":
    print(size_table())
