"""The site: its style in a browser, in the theme's columns with every printed table and drawing of the pages; its links."""

import html
import importlib.util
import re
from pathlib import Path

import pytest

from tests.support.browser import Opened, chromium

pytestmark = pytest.mark.slow
DOCS = Path(__file__).resolve().parent.parent / "docs"


def loaded(path: Path):
    """Return a module that belongs to no package."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


broken_links = loaded(DOCS / "links.py").broken_links
# What the theme gives a page: bars of 15em to the left and, where there is room, to the right of the column.
THEME = """
body { margin: 0; font-size: 16px; } .page { display: flex; } .sidebar-drawer { min-width: 15em; box-sizing: border-box; }
.toc-drawer { width: 15em; flex-shrink: 0; } .content { width: 46em; padding: 0 3em; flex-shrink: 0; }
pre { font: 0.8125rem/1.5 monospace; margin: 0; padding: 0.625rem 0.875rem; overflow: auto; }
@media print { .sidebar-drawer, .toc-drawer { display: none; } .content { width: 100%; box-sizing: border-box; } }
"""
# What a sheet of A4 has room for between its margins [px].
PAPER = 703


def blocks_of(kinds: str) -> list[str]:
    """Return the blocks of all pages whose kind a pattern matches."""
    pattern = re.compile(rf"^```(?:{kinds})\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
    return [block for page in sorted(DOCS.glob("*.md")) for block in pattern.findall(page.read_text(encoding="utf-8"))]


def columned() -> list[str]:
    """Return the printed texts of all pages that have columns: tables and drawings."""
    return [block for block in blocks_of(r"text|\{code-block\} text") if re.search(r"\S {2,}\S", block)]


def written(place: Path, blocks: list[tuple[str, str]]) -> Path:
    """Write a page of blocks, each with its kind, in the theme's columns, and return its path."""
    style = (DOCS / "static" / "site.css").read_text(encoding="utf-8")
    shown = "".join(
        f'<div class="highlight-{kind} highlight"><pre>{html.escape(block)}</pre></div>' for kind, block in blocks
    )
    columns = f'<div class="sidebar-drawer"></div><div class="content">{shown}</div><div class="toc-drawer"></div>'
    place.write_text(f'<style>{THEME}{style}</style><div class="page">{columns}</div>', encoding="utf-8")
    return place


@pytest.mark.parametrize("width", [1100, 1400, 1560, 1920])
def test_tables_and_drawings_are_in_one_piece_and_the_page_does_not_scroll_sideways(width, tmp_path):
    blocks = columned()
    assert len(blocks) > 10
    assert max(len(line) for block in blocks for line in block.splitlines()) > 120
    place = written(tmp_path / "site.html", [("text", block) for block in blocks])
    with chromium() as browser:
        opened = Opened(browser, place, width=width)
        assert opened.ask("document.documentElement.scrollWidth") <= width
        folds = "[...document.querySelectorAll('pre')].map((block) => getComputedStyle(block).whiteSpace)"
        assert set(opened.ask(folds)) == {"pre"}
        if width >= 1400:
            assert opened.ask(
                "[...document.querySelectorAll('pre')].every((block) => block.scrollWidth <= block.clientWidth)"
            )


def test_on_paper_no_line_of_code_or_of_a_table_is_cut_off(tmp_path):
    code = [("toml", block) for block in blocks_of("toml|python|sh")]
    assert max(len(line) for _, block in code for line in block.splitlines()) > 100
    place = written(tmp_path / "site.html", [*code, *(("text", block) for block in columned())])
    with chromium() as browser:
        opened = Opened(browser, place, width=PAPER)
        opened.page.emulate_media(media="print")
        assert opened.ask("document.documentElement.scrollWidth") <= PAPER
        wide = "[...document.querySelectorAll('pre')].filter((one) => one.scrollWidth > one.clientWidth)"
        assert opened.ask(f"{wide}.map((one) => one.innerText)") == []


def test_links_of_a_site_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "picture.png").write_bytes(b"")
    there = '<a href="../index.html#here">a</a> <a href="#own" id="own">b</a> <img src="../picture.png"/>'
    (tmp_path / "notebooks" / "one.html").write_text(there + '\n<a href="../index.html#gone">c</a>', encoding="utf-8")
    away = '<a href="https://example.org/x">d</a> <a href="mailto:a@b">e</a> <h1 id="here"></h1>'
    (tmp_path / "index.html").write_text(away + '<a href="notebooks/two.html">f</a>', encoding="utf-8")
    assert broken_links(tmp_path) == [
        "index.html, line 1: notebooks/two.html is missing",
        "notebooks/one.html, line 2: ../index.html#gone is missing",
    ]
