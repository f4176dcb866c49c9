"""`linkplan explore` as a process: refused strangers, a page that a browser drives, a saved problem, Ctrl-C."""

import http.client
import json
import re
import signal
import subprocess
import sys
from urllib.parse import urlsplit

import pytest

from linkplan.planner.problem.problem import load_problem
from tests.support.browser import chromium, violations


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("explored")


@pytest.fixture(scope="module")
def served(folder):
    """Yield the address of a running server; it ends by Ctrl-C, with the exit code of an interrupted command."""
    run = [sys.executable, "-m", "linkplan", "explore", "knee-reach", "--json"]
    piped: dict = {"cwd": folder, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A process of a script's background inherits that SIGINT is ignored; a terminal's does not. A handler is not inherited.
    # A `preexec_fn` would first copy the process of the tests, for which memory may be lacking.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with subprocess.Popen(run, **piped) as process:
        signal.signal(signal.SIGINT, before)
        said = json.loads(process.stdout.readline())
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{20,}/", said["address"])
        assert said["problem"] == "knee-reach"
        yield said["address"]
        process.send_signal(signal.SIGINT)
        assert "no longer served" in process.communicate(timeout=20)[1]
        assert process.returncode == 130


def status(address: str, path: str | None = None, method: str = "GET", body: str | None = None, **headers: str) -> int:
    """Return the status of a request to the server of an address."""
    at = urlsplit(address)
    connection = http.client.HTTPConnection(at.hostname, at.port, timeout=30)
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, at.path if path is None else path, body=body, headers=named)
    return connection.getresponse().status


@pytest.mark.slow
def test_strangers_are_refused(served):
    assert status(served, "/") == 403
    assert status(served, "/wrong-token/controls") == 403
    assert status(served, Host="evil.example") == 403
    plan = urlsplit(served).path + "plan"
    assert status(served, plan, "POST", "{}", Origin="http://evil.example") == 403
    assert status(served, plan, "POST", "[]") == 400
    assert status(served, plan) == 404  # a plan is asked for by POST
    assert status(served, urlsplit(served).path + "controls") == 200


@pytest.mark.slow
def test_a_browser_moves_a_slider_and_saves(served, folder):
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        page.goto(served)
        page.locator("input[data-key='goal_deg.O']").wait_for()
        slider = page.locator("input[data-key='duration_s']")
        slider.fill("0.25")
        page.get_by_text(re.compile(r"planned in \d+ ms")).wait_for()
        page.get_by_text("0.25 s", exact=True).first.wait_for()
        assert page.locator(".verdict.good").inner_text().startswith("Locally effort-optimal motion of 0.25 s")
        assert page.locator("canvas.stage").count() == 1
        box = page.locator("input[data-number='duration_s']")
        assert box.input_value() == "0.25"
        box.fill("0.3")
        box.press("Tab")
        page.get_by_text("0.3 s", exact=True).first.wait_for()
        assert float(slider.input_value()) == pytest.approx(0.3)
        box.fill("0.25")
        box.press("Tab")
        page.get_by_text("0.25 s", exact=True).first.wait_for()
        page.get_by_label("tracker", exact=True).select_option("lqr")
        page.locator("table", has_text="lqr").first.wait_for()
        page.get_by_role("button", name="Save problem file").click()
        page.get_by_text("saved problem.toml").wait_for()
        assert errors == []
        assert violations(page) == []
        page.emulate_media(media="print")
        assert not page.locator("form.explore").is_visible()
        page.emulate_media(media="screen")
        # While a value is refused, the page shows no verdict of the motion before.
        page.evaluate("explored.values.duration_s = 1000; planAgain(document.querySelector('output.said'))")
        page.locator(".said.bad").wait_for()
        assert page.locator(".said").inner_text().startswith("duration_s is from 0.04 to 0.64 s, got 1000")
        assert page.locator(".page .good.verdict").count() == 0
        assert page.locator(".verdict.bad").inner_text().startswith("Not of these values: duration_s is from")
        slider.fill("0.24")
        page.locator(".verdict.good").wait_for()
        assert page.locator(".stale, .said.bad").count() == 0
    assert load_problem(folder / "problem.toml").motion.duration_s == 0.25
    assert "0.16 s" not in (folder / "problem.toml").read_text(encoding="utf-8")
