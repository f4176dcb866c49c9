"""The blocks of a page of the documents, and what it takes to run them as a reader would, in the page's own order.

A comment in the line before a block says what the block alone does not:

    <!-- file: NAME -->        the block is that file (`toml`, `xml`, `python`)
    <!-- part of: NAME -->     keys (`toml`) to set in that file, as a reader would for a moment
    <!-- exit: 1 -->           the exit code of the block's last command, where it is not 0
    <!-- shown: WHY -->        the block is not run
    <!-- from: PATH -->        before a picture: the file among what the page's commands write that it is a copy of
"""

import contextlib
import difflib
import io
import re
import shlex
import shutil
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import linkplan
from linkplan.cli.main import main
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.batch_file import read_batch
from linkplan.studies.variations.size.candidates import read_motors

# What may stand in a page, and is run or read. Directives ("{toctree}") are the site's own.
KINDS = ("sh", "text", "python", "toml", "xml", "csv")
_FENCE = re.compile(r"^( *)(`{3,}|:{3,})(\S*)[^`]*$")
_MARK = re.compile(r"^<!-- (file|part of|exit|shown|from): (.+?) -->$")
_PICTURE = re.compile(r"^!\[[^\]]*\]\(([^)\s]+)\)")
_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# Figures on a page are those of this machine: others round and iterate otherwise. What is rounding itself is compared with
# nothing but a bound.
_SAME, _ROUNDING = 0.02, 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One block, or picture, of a page: its kind, text, first line and what the comment before it says."""

    kind: str
    text: str
    line: int
    marks: dict[str, str]

    @property
    def runs(self) -> bool:
        """Whether the block is run or read."""
        return "shown" not in self.marks


def blocks(page: Path) -> list[Block]:
    """Return the blocks of a page in order, and the pictures that say what they are copies of."""
    found, marks = [], {}
    lines = iter(enumerate(page.read_text(encoding="utf-8").splitlines(), 1))
    for number, line in lines:
        if mark := _MARK.match(line.strip()):
            marks[mark[1]] = mark[2]
        elif fence := _FENCE.match(line):
            inside = []
            for _, below in lines:
                if below.strip() == fence[2]:
                    break
                inside.append(below.removeprefix(fence[1]))
            if not fence[3].startswith("{"):
                found.append(Block(kind=fence[3], text="\n".join(inside) + "\n", line=number, marks=marks))
            marks = {}
        elif (picture := _PICTURE.match(line)) and "from" in marks:
            found.append(Block(kind="picture", text=picture[1], line=number, marks=marks))
            marks = {}
        elif line.strip():
            marks = {}
    return found


def commands(block: Block) -> list[str]:
    """Return the lines of a block of commands, continued ones joined, comments left out."""
    joined = block.text.replace("\\\n", " ").splitlines()
    return [line.strip() for line in joined if line.strip() and not line.lstrip().startswith("#")]


@dataclass
class Reader:
    """Somebody who follows a page in an empty folder. Mutable: names defined, what was last printed, what was skipped."""

    page: Path
    pending: tuple[str, ...] = ()
    printed: list[tuple[str, str]] | None = None  # where it is a list: what is shown and what was printed, not compared
    names: dict = field(default_factory=lambda: {"__name__": "__page__"})
    said: str = ""
    skipped: bool = False

    def follow(self) -> None:
        """Run every block of the page, in order, in the working folder."""
        for block in blocks(self.page):
            if not block.runs:
                continue
            try:
                self._do(block)
            except BaseException as error:
                error.add_note(f"in {self.page.name}, line {block.line}, a block of {block.kind}")
                raise

    def _do(self, block: Block) -> None:
        if block.kind == "sh":
            self._command(block)
        elif block.kind == "text":
            assert self.skipped or self.said, "nothing was printed before"
            if not self.skipped and self.printed is None:
                compare_output(block.text, self.said)
            elif not self.skipped:
                self.printed.append((block.text, self.said))
        elif block.kind == "picture":
            source = block.marks["from"]
            assert self._is_pending(source) or Path(source).is_file(), f"no command of this page wrote {source}"
        elif self._is_pending(block.text):
            self.skipped = True
        elif block.kind == "python":
            self._python(block)
        else:
            _read(block)

    def _is_pending(self, text: str) -> bool:
        return any(word in text for word in self.pending)

    def _command(self, block: Block) -> None:
        said, lines = io.StringIO(), commands(block)
        run = [line for line in lines if not self._is_pending(line)]
        for line in run:
            words = shlex.split(line, comments=True)
            assert words[0] == "linkplan", f"'{line}' is no command of ours"
            with contextlib.redirect_stdout(said):
                code = main(words[1:])
            wanted = int(block.marks.get("exit", 0)) if line is lines[-1] else 0
            assert code == wanted, f"'{line}' ended with exit code {code}"
        self.said, self.skipped = said.getvalue(), len(run) < len(lines)

    def _python(self, block: Block) -> None:
        if name := block.marks.get("file"):
            Path(name).write_text(block.text, encoding="utf-8")
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            exec(compile(block.text, f"{self.page.name}:{block.line}", "exec"), self.names)
        self.said, self.skipped = said.getvalue(), False


def _read(block: Block) -> None:
    """Read a file that a page shows as linkplan reads it, and write it where the page names it."""
    if block.kind == "xml":
        linkplan.load_mechanism(block.text)
    elif of := block.marks.get("part of"):
        tables = tomllib.loads(Path(of).read_text(encoding="utf-8"))
        for name, table in tomllib.loads(block.text).items():
            tables[name] = tables.get(name, {}) | table
        Problem.from_tables(Path(of).stem, tables, Path.cwd())
    name = block.marks.get("file")
    if name or block.kind == "toml":
        place = Path(name or "a-block-without-a-name.toml")
        if "part of" not in block.marks:
            place.write_text(block.text, encoding="utf-8")
        if block.kind == "toml" and "part of" not in block.marks:
            tables = tomllib.loads(block.text)
            whole = linkplan.PhasedProblem if "phases" in tables else linkplan.Problem
            reader = read_batch if "sweep" in tables or "case" in tables else whole.from_file
            (read_motors if "motor" in tables else reader)(place)


def compare_output(shown: str, said: str) -> None:
    """Assert that what a page shows was printed: its lines in order, `...` for what is left out, figures to 2 %.

    Figures of less than a ten-thousandth are errors of rounding and iteration: they must be so small, and no more.
    """
    rest, anywhere = iter(said.splitlines()), False
    for line in shown.splitlines():
        if line.strip() == "...":
            anywhere = True
            continue
        for candidate in rest:
            if _same_line(line, candidate):
                break
            assert anywhere or not candidate.strip(), f"shown: {line!r}, printed: {candidate!r}"
        else:
            raise AssertionError(f"shown, but not printed: {line!r}\n{said}")
        anywhere = False


def _same_line(shown: str, said: str) -> bool:
    shown, said = _plain(shown), _plain(said)
    if "..." in shown:
        return re.fullmatch(".*".join(re.escape(part) for part in shown.split("...")), said) is not None
    if _NUMBER.sub("#", shown) != _NUMBER.sub("#", said):
        return False
    pairs = zip(_NUMBER.findall(shown), _NUMBER.findall(said), strict=True)
    return all(_same(float(a), float(b)) for a, b in pairs)


def _plain(line: str) -> str:
    """Return a line without what columns' widths decide."""
    return re.sub(r"-{3,}", "---", " ".join(line.split()))


def _same(shown: float, said: float) -> bool:
    return abs(shown - said) <= max(_SAME * abs(shown), _ROUNDING)


def as_printed(shown: str, said: str) -> str:
    """Return what a page shows in the words and figures that are printed now, with `...` where it was.

    Each run of lines between two `...` becomes the printed lines from that most like its first to that most like its last.
    """
    printed, at, found = said.splitlines(), 0, []

    def nearest(line: str) -> int:
        bare = _NUMBER.sub("#", _plain(line))
        likeness = [difflib.SequenceMatcher(None, bare, _NUMBER.sub("#", _plain(one))).ratio() for one in printed[at:]]
        assert max(likeness, default=0.0) > 0.5, f"nothing like {line!r} was printed any more"
        return at + likeness.index(max(likeness))

    for run in re.split(r"^ *\.\.\. *\n", shown, flags=re.MULTILINE):
        lines = [line for line in run.splitlines() if line.strip()]
        if lines:
            first = nearest(lines[0])
            at = first
            at = nearest(lines[-1]) + 1
            short = [line for line in lines if "..." in line]
            now = (next((one for one in short if _same_line(one, line)), line) for line in printed[first:at])
            found.append("".join(f"{line.rstrip()}\n" for line in now))
        else:
            found.append(run)
    return "...\n".join(found)


def take_pictures(page: Path) -> list[Path]:
    """Copy the pictures that a page's commands wrote in the working folder to where the page shows them."""
    taken = []
    for block in blocks(page):
        source = Path(block.marks.get("from", ""))
        if block.kind == "picture" and source.is_file():
            target = page.parent / block.text
            target.parent.mkdir(exist_ok=True)
            taken.append(Path(shutil.copy(source, target)))
    return taken
