"""The server of `linkplan explore`: the user's files stay as they are, wrong requests get one line, and none a traceback."""

import contextlib
import json
import socket
import struct
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from linkplan.models.errors import PlanFileError
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.studies.explore.server import Server
from linkplan.studies.explore.session import Session
from linkplan.viewing import SavedProblem


@pytest.fixture(scope="module")
def problems() -> list[Problem]:
    first = load_problem("knee-reach")
    return [first, first.with_settings({"motion.duration_s": 0.3})]


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
    with pytest.raises(PlanFileError, match="is there already"):
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


@pytest.mark.parametrize(
    "asked",
    [
        {"values": {"duration_s": "x"}},
        {"values": {"duration_s": None}},
        {"values": {"duration_s": [1]}},
        {"values": {"duration_s": {}}},
        {"values": {"duration_s": float("nan")}},
        {"values": {"duration_s": float("inf")}},
        {"values": {"duration_s": True}},
        {"values": {"duration_s": 10**400}},
        {"values": {"unknown": 1}},
        {"values": {"": 1}},
        {"objective": "unknown"},
        {"objective": ""},
        {"objective": "\ud800"},
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
