"""The style of the site, in a browser: the theme's three columns with every printed table and drawing of the pages."""

import html
import re
from pathlib import Path

import pytest

from tests.support.browser import Opened, chromium

pytestmark = pytest.mark.slow
DOCS = Path(__file__).resolve().parent.parent / "docs"
# What the theme gives a page: bars of 15em to the left and, where there is room, to the right of the column.
THEME = """
body { margin: 0; font-size: 16px; } .page { display: flex; } .sidebar-drawer { min-width: 15em; box-sizing: border-box; }
.toc-drawer { width: 15em; flex-shrink: 0; } .content { width: 46em; padding: 0 3em; flex-shrink: 0; }
pre { font: 0.8125rem/1.5 monospace; margin: 0; padding: 0.625rem 0.875rem; overflow: auto; }
"""


def columned() -> list[str]:
    """Return the printed texts of all pages that have columns: tables and drawings."""
    pattern = re.compile(r"^```(?:text|\{code-block\} text)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
    blocks = [block for page in sorted(DOCS.glob("*.md")) for block in pattern.findall(page.read_text(encoding="utf-8"))]
    return [block for block in blocks if re.search(r"\S {2,}\S", block)]


@pytest.mark.parametrize("width", [1100, 1400, 1560, 1920])
def test_tables_and_drawings_are_in_one_piece_and_the_page_does_not_scroll_sideways(width, tmp_path):
    """At 1400 px they were folded, and every page was 40 px too wide."""
    blocks = columned()
    assert len(blocks) > 10
    assert max(len(line) for block in blocks for line in block.splitlines()) > 120
    style = (DOCS / "static" / "site.css").read_text(encoding="utf-8")
    shown = "".join(f'<div class="highlight-text"><pre>{html.escape(block)}</pre></div>' for block in blocks)
    columns = f'<div class="sidebar-drawer"></div><div class="content">{shown}</div><div class="toc-drawer"></div>'
    place = tmp_path / "site.html"
    place.write_text(f'<style>{THEME}{style}</style><div class="page">{columns}</div>', encoding="utf-8")
    with chromium() as browser:
        opened = Opened(browser, place, width=width)
        assert opened.ask("document.documentElement.scrollWidth") <= width
        folds = "[...document.querySelectorAll('pre')].map((block) => getComputedStyle(block).whiteSpace)"
        assert set(opened.ask(folds)) == {"pre"}
        if width >= 1400:
            assert opened.ask(
                "[...document.querySelectorAll('pre')].every((block) => block.scrollWidth <= block.clientWidth)"
            )
