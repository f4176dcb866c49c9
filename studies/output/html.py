"""A page of results: headings, plain-text tables and figures beside it in the folder."""

import html
from pathlib import Path

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #ddd; }
pre { background: #f6f7f8; padding: .8rem 1rem; white-space: pre-wrap; border-radius: 4px; }
pre { font-size: 12.5px; line-height: 1.4; }
figure { margin: 1.2rem 0; } img { max-width: 100%; } figcaption { color: #555; font-size: 13px; }
"""


class Page:
    """A page that is written once, at the end."""

    def __init__(self, title: str) -> None:
        self._title = title
        self._parts: list[str] = []

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def text(self, text: str) -> None:
        """Add lines as they stand on the terminal."""
        self._parts.append(f"<pre>{html.escape(text)}</pre>")

    def note(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def figure(self, path: str, caption: str) -> None:
        """Add a figure by its path relative to the page."""
        source, words = html.escape(path, quote=True), html.escape(caption)
        self._parts.append(f'<figure><img src="{source}" alt="{words}"><figcaption>{words}</figcaption></figure>')

    def save(self, path: Path) -> None:
        """Write the page."""
        title = html.escape(self._title)
        body = "\n".join(self._parts)
        path.write_text(
            f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
            f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n'
            f"<body><h1>{title}</h1>\n{body}\n</body></html>\n",
            encoding="utf-8",
        )
