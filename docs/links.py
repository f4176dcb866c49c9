"""The links of a built site that lead nowhere: `make docs` warns of each, and a warning is an error there."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class _Page(HTMLParser):
    """The targets that a page names, with their lines, and the places on it that others can name."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.targets: list[tuple[int, str]] = []
        self.places: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, _tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.places |= {given[name] for name in ("id", "name") if name in given}
        self.targets += [(self.getpos()[0], given[name]) for name in ("href", "src") if name in given]


def broken_links(site: Path) -> list[str]:
    """Return a line on each href or src of a site's pages whose file, or place on a page, is missing; skip other sites."""
    pages = {path: _Page(path) for path in sorted(site.rglob("*.html"))}
    broken = []
    for path, page in pages.items():
        for line, target in page.targets:
            link = urlsplit(target)
            if link.scheme or link.netloc:
                continue
            named = (path.parent / unquote(link.path)).resolve() if link.path else path
            place = unquote(link.fragment)
            known = named.exists() and (not place or named not in pages or place in pages[named].places)
            if not known:
                broken.append(f"{path.relative_to(site)}, line {line}: {target} is missing")
    return broken
