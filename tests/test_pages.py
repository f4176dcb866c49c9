"""Every page of the documents, followed to the letter: each in its own empty folder, its blocks in order.

`python -m tests.test_pages [--text] [PAGE.md ...]` draws the pages' pictures again from what their commands write, and with
--text also writes again what the pages show as printed, in today's words and figures: read the difference. A notebook's name
(`NAME.py`) executes it and writes `NAME.ipynb`.
"""

import os
import re
import sys
import tempfile
from pathlib import Path

import nbformat
import pytest

from tests.support.notebooks import MOST_BYTES, cells_of, executed, pictures, printed
from tests.support.pages import KINDS, Reader, as_printed, blocks, commands, compare_output, take_pictures

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.py"))
# What pages tell of already and is not merged yet: a command line, block or picture with one of these in it is left out.
PENDING: tuple[str, ...] = ()
# Times that a notebook printed, which differ from run to run.
TIMES = re.compile(r"in \d[\d.]* s$", flags=re.MULTILINE)
# Blocks that are shown and not run, over all pages.
MOST_SHOWN = 12


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def has_work(page: Path) -> bool:
    return any(block.runs and block.kind in ("sh", "python") for block in blocks(page))


def test_there_are_pages_with_blocks_of_every_kind():
    assert len(PAGES) > 12
    assert {block.kind for page in PAGES for block in blocks(page)} >= set(KINDS)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_block_is_of_a_kind_that_is_run(page):
    for block in blocks(page):
        where = f"{name(page)}, line {block.line}"
        assert not block.runs or block.kind in (*KINDS, "picture"), where
        for line in commands(block) if block.kind == "sh" and block.runs else ():
            assert line.startswith("linkplan "), f"{where}: {line}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_no_block_is_hidden_in_an_indent(page):
    text = re.sub(r"^ *(`{3,}|:{3,}).*?^ *\1\s*$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^\n {4}\S.*", text, flags=re.MULTILINE)
    assert not indented


def test_few_blocks_are_shown_and_not_run():
    shown = [f"{name(page)}, line {block.line}" for page in PAGES for block in blocks(page) if not block.runs]
    assert 0 < len(shown) <= MOST_SHOWN, shown


@pytest.mark.parametrize(
    "page", [pytest.param(p, marks=pytest.mark.slow) if has_work(p) else p for p in PAGES if blocks(p)], ids=name
)
def test_a_page_does_what_it_says(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Reader(page=page, pending=PENDING).follow()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name)
def test_an_executed_notebook_has_the_cells_of_its_file_and_is_small(notebook):
    saved = nbformat.read(notebook.with_suffix(".ipynb"), as_version=4)
    assert [(cell.cell_type, cell.source) for cell in saved.cells] == cells_of(notebook)
    assert len(saved.cells) > 8
    assert sum(pictures(saved)) > 0
    assert notebook.with_suffix(".ipynb").stat().st_size < MOST_BYTES


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=name)
def test_a_notebook_runs_from_top_to_bottom_and_shows_what_is_saved(notebook, tmp_path):
    saved, now = nbformat.read(notebook.with_suffix(".ipynb"), as_version=4), executed(notebook, tmp_path)
    assert pictures(now) == pictures(saved)
    for shown, said in zip(printed(saved), printed(now), strict=True):
        compare_output(TIMES.sub("in ... s", shown), said)


@pytest.mark.parametrize(
    ("shown", "said", "same"),
    [
        ("peak 86.32 N.m", "peak  86.33   N.m", True),
        ("peak 86.32 N.m", "peak 96.32 N.m", False),
        ("peak 86.32 N.m", "least 86.32 N.m", False),
        ("error 5.6e-09 deg", "error 2.1e-08 deg", True),
        ("error 5.6e-09 deg", "error 0.3 deg", False),
        ("a\n...\nc 1", "a\nb\nc 1", True),
        ("a\nc 1", "a\nb\nc 1", False),
        ("took ... s in all", "took 3.2 s in all", True),
        ("took ... s in all", "took 3.2 s", False),
    ],
)
def test_output_that_a_page_shows_is_compared(shown, said, same):
    if same:
        compare_output(shown, said)
    else:
        with pytest.raises(AssertionError):
            compare_output(shown, said)


def test_output_is_written_again_with_its_gaps_where_they_were():
    shown = "peak 86.3 N.m\n...\nname  rms [deg]\n----\npd  4.8\n...\ntook ... s\n"
    said = "peak 96.5 Nm\nb\nc\nname   rms\n      [deg]\n----\npd    5.3\nlqr   0.1\ntook 3.1 s\n"
    now = "peak 96.5 Nm\n...\nname   rms\n      [deg]\n----\npd    5.3\n...\ntook ... s\n"
    assert as_printed(shown, said) == now
    compare_output(now, said)


def follow(page: Path, rewrite: bool) -> None:
    """Draw a page's pictures again, and write again what it shows as printed."""
    before = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        reader = Reader(page=page, pending=PENDING, printed=[] if rewrite else None)
        reader.follow()
        print(name(page), *take_pictures(page), file=sys.stderr)
        os.chdir(before)
    text = page.read_text(encoding="utf-8")
    for shown, said in reader.printed or ():
        text = text.replace(f"```text\n{shown}```", f"```text\n{as_printed(shown, said)}```")
    page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    wanted = [word for word in sys.argv[1:] if word != "--text"]
    for page in PAGES:
        kinds = {block.kind for block in blocks(page) if block.runs}
        if kinds & ({"picture", "text"} if "--text" in sys.argv else {"picture"}) and (not wanted or page.name in wanted):
            follow(page, rewrite="--text" in sys.argv)
    for notebook in NOTEBOOKS:
        if notebook.name in wanted:
            with tempfile.TemporaryDirectory() as folder:
                nbformat.write(executed(notebook, Path(folder)), notebook.with_suffix(".ipynb"))
