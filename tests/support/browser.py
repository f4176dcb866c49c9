"""A browser without a screen, which reads pages from disk with the network off and keeps what goes wrong on them."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def chromium() -> Iterator:
    """Yield playwright's browser; skip where there is none, with the reason."""
    found = next((path for name in _NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no browser is installed, of {', '.join(_NAMES)}")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            browser.close()


class Opened:
    """A page that was opened from disk: playwright's `page`, the errors it reported, the addresses it asked for.

    `script` runs before those of the page. Pages opened before are closed: their mechanisms would go on moving, and take the
    processor's time.
    """

    def __init__(self, browser, path: Path, width: int = 1400, scheme: str = "light", script: str = "") -> None:
        self.errors: list[str] = []
        self.asked: list[str] = []
        for before in browser.contexts:
            before.close()
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme, offline=True)
        context.add_init_script(script)
        self.page = context.new_page()
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda said: self.errors.append(said.text) if said.type in ("error", "warning") else None)
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(path.as_uri())

    def ask(self, script: str, *given):
        """Return what an expression is on the page, or what a function on the page gives for an argument."""
        return self.page.evaluate(script, *given)

    def build(self) -> Self:
        """Build all plots, those far below the window too, and let two frames pass; return the page."""
        self.ask("whenSeen.all.forEach((build) => build())")
        self.settle()
        return self

    def settle(self) -> None:
        """Wait until what was asked for has been drawn."""
        self.ask("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 0))))")


def violations(page) -> list[str]:
    """Return what axe-core finds against WCAG on a page: the rule and the first element that breaks it."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    found = axe.Axe().run(page).response["violations"]
    return [f"{one['id']}: {one['help']}; {one['nodes'][0]['html']}" for one in found]
