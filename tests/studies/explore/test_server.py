"""The server of `linkplan explore`: the user's files stay as they are, wrong requests get one line, and none a traceback."""

import contextlib
import http.client
import json
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from linkplan.api.viewing import SavedProblem
from linkplan.models.errors import PlanFileError
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.studies.explore.server import Server
from linkplan.studies.explore.session import Session
from tests.support.browser import chromium, violations


@pytest.fixture(scope="module")
def problems() -> list[Problem]:
    first = load_problem("knee-reach")
    return [first, first.replace({"motion.duration_s": 0.3})]


def edited(place: Path) -> None:
    place.write_text(place.read_text(encoding="utf-8") + "# mine\n", encoding="utf-8")


def same_length(place: Path) -> None:
    place.write_bytes(b"#" * place.stat().st_size)


def linked(place: Path) -> None:
    place.rename(place.with_name("kept.toml"))
    place.symlink_to("kept.toml")


def dangling(place: Path) -> None:
    place.unlink()
    place.symlink_to("nowhere.toml")


def folder(place: Path) -> None:
    place.unlink()
    place.mkdir()


@pytest.mark.parametrize("change", [edited, same_length, linked, dangling, folder])
def test_a_second_save_replaces_only_what_the_first_one_wrote(change, problems, tmp_path):
    place = tmp_path / "problem.toml"
    saved = SavedProblem(place=place)
    saved.save(problems[0])
    change(place)
    before = {one.name: (one.is_symlink(), one.read_bytes() if one.is_file() else None) for one in tmp_path.iterdir()}
    with pytest.raises(PlanFileError, match="nothing is overwritten; move it or name another") as refused:
        saved.save(problems[1])
    assert "\n" not in str(refused.value)
    assert {
        one.name: (one.is_symlink(), one.read_bytes() if one.is_file() else None) for one in tmp_path.iterdir()
    } == before


def test_a_second_save_replaces_the_first_one_and_writes_a_file_that_is_gone(problems, tmp_path):
    place = tmp_path / "problem.toml"
    saved = SavedProblem(place=place)
    for gone in (False, False, True):
        if gone:
            place.unlink()
        for problem in problems:
            saved.save(problem)
            assert load_problem(place).motion.duration_s == problem.motion.duration_s


def test_a_file_that_was_there_before_the_page_is_refused(problems, tmp_path):
    place = tmp_path / "problem.toml"
    place.write_bytes(problems[0].to_toml().encode())
    with pytest.raises(PlanFileError, match="already exists"):
        SavedProblem(place=place).save(problems[0])


@pytest.fixture
def told() -> list[BaseException]:
    return []


@pytest.fixture
def server(problems, told):
    with Server(Session(first=problems[0]), lambda _: "nowhere", tell=told.append) as made:
        thread = threading.Thread(target=made.serve_forever)
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def posted(server: Server, body: bytes, path: str = "plan") -> tuple[int, str]:
    request = urllib.request.Request(server.address + path, data=body, method="POST")
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.parametrize(
    "body",
    [
        b'{"values": [1]}', b'{"values": null}', b'{"values": 3}', b'{"values": "x"}', b'{"objective": 3}',
        b'{"objective": ["effort"]}', b'{"objective": {}}', b'{"objective": true}', b"[]", b"", b"{", b"\xff", b"[" * 99_000,
        b'{"values": {"x": ' + b"[" * 50_000, b"1" * 5000, b"null", b'"' + b"x" * 200_000 + b'"',
    ],
)  # fmt: skip
def test_a_body_of_another_form_gets_a_line_and_code_400(body, server, told, capfd):
    code, said = posted(server, body)
    assert code == 400
    assert len(said.splitlines()) == 1
    assert told == []
    assert capfd.readouterr().err == ""


NO_DURATIONS = ("x", None, [1], {}, float("nan"), float("inf"), True, 10**400)


@pytest.mark.parametrize(
    "asked",
    [
        *({"values": {"duration_s": value}} for value in NO_DURATIONS),
        *({"values": {name: 1}} for name in ("unknown", "")),
        *({"objective": name} for name in ("unknown", "", "\ud800")),
    ],
)
def test_values_that_make_no_problem_are_refused_in_one_line(asked, server, told, capfd):
    code, said = posted(server, json.dumps(asked).encode())
    assert code == 200
    assert len(json.loads(said)["refused"].splitlines()) == 1
    assert told == []
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "request_of", [b"POST /{token}/controls HTTP/1.1\r\nContent-Length: 9\r\n\r\n", b"GET /{token}/ HTTP/1.1\r\n"]
)
def test_a_browser_that_goes_away_leaves_nothing_on_the_terminal(request_of, server, told, capfd):
    for reset in (True, False) * 3:
        with contextlib.closing(socket.create_connection(("127.0.0.1", server.server_port), timeout=30)) as client:
            client.sendall(request_of.replace(b"{token}", server.token.encode()))
            if reset:  # the connection is reset and not closed
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert posted(server, b"[]")[0] == 400  # the server goes on
    assert told == []
    assert capfd.readouterr().err == ""


def test_an_error_that_is_no_refusal_is_told_and_answered(server, told, capfd):
    def fails(_: Problem) -> str:
        raise ZeroDivisionError("of a test")

    server.save = fails
    code, said = posted(server, b"{}", "save")
    assert (code, len(said.splitlines())) == (500, 1)
    assert [type(error) for error in told] == [ZeroDivisionError]
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("error", [BrokenPipeError(), ConnectionResetError(), ConnectionAbortedError(), TimeoutError()])
def test_a_connection_that_ends_is_no_error(error, server, told, capfd):
    try:
        raise error
    except OSError:
        server.handle_error(None, ("127.0.0.1", 1))
    assert told == []
    assert capfd.readouterr().err == ""


@pytest.fixture(scope="module")
def served_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("explored")


@pytest.fixture(scope="module")
def served(served_folder):
    """Yield the address of a running server; it ends by Ctrl-C, with the exit code of an interrupted command."""
    run = [sys.executable, "-m", "linkplan", "explore", "knee-reach", "--json"]
    piped: dict = {"cwd": served_folder, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
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
def test_a_browser_moves_a_slider_and_saves(served, served_folder):
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
        page.evaluate("explored.values.duration_s = -1; planAgain(document.querySelector('output.said'))")
        page.locator(".said.bad").wait_for()
        assert page.locator(".said").inner_text().startswith("motion.duration_s must be")
        assert page.locator(".page .good.verdict").count() == 0
        assert page.locator(".verdict.bad").inner_text().startswith("Not of these values: motion.duration_s must be")
        slider.fill("0.24")
        page.locator(".verdict.good").wait_for()
        assert page.locator(".stale, .said.bad").count() == 0
    assert load_problem(served_folder / "problem.toml").motion.duration_s == 0.25
    assert "0.16 s" not in (served_folder / "problem.toml").read_text(encoding="utf-8")
