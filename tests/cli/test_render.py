"""`linkplan render` and `view` from the outside."""

import json
import os
import signal

import av
import pytest
from PIL import Image

from linkplan.controllers.controls import KEYS, Controls, pressed
from linkplan.studies.render import render as render_module
from linkplan.studies.render.live import run_maker
from tests.support.plans import optimal, saved_plan

SMALL = ("--size-px", "160x120", "--fps", "10", "--slow", "5")
REFUSED = [
    (["-o", "film.avi"], [".mp4, .gif or .png", ".avi"]),
    (["-o", "film.mp4", "--fps", "-3"], ["fps", "-3"]),
    (["-o", "film.mp4", "--slow", "0"], ["slow", "0"]),
    (["-o", "film.mp4", "--size-px", "200"], ["WIDTHxHEIGHT", "200"]),
    (["-o", "film.mp4", "--at-s", "0.1"], [".png"]),
    (["-o", "film.mp4", "--tracker", "pid"], ["pid", "pd+ff"]),
    (["-o", "nowhere/film.mp4"], ["nowhere", "no folder"]),
]


@pytest.fixture
def flat(monkeypatch, tmp_path):
    """Leave no OpenGL to draw with, in a folder of the test's own."""
    monkeypatch.setenv("MUJOCO_GL", "disable")
    monkeypatch.chdir(tmp_path)
    return saved_plan("knee-reach", tmp_path).name


@pytest.mark.parametrize(("words", "said"), REFUSED)
def test_what_cannot_be_drawn_is_refused_in_a_line_before_any_planning(words, said, ask, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    code, out, err = ask("render", "knee-reach", *words)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert all(word in err for word in said), err
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_linkplan_did_not_write_is_left_alone(ask, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "film.mp4").write_bytes(b"holidays")
    code, _, err = ask("render", "knee-reach", "-o", "film.mp4")
    assert (code, err.count("\n")) == (2, 1)
    assert "was not written by linkplan" in err
    assert (tmp_path / "film.mp4").read_bytes() == b"holidays"


def test_without_opengl_the_film_is_drawn_flat_and_says_so(flat, ask, tmp_path):
    code, out, err = ask("render", flat, "-o", "film.mp4", *SMALL)
    assert code == 0
    assert "Matplotlib" in out
    assert "no OpenGL" in err
    assert "MUJOCO_GL is disable" in err
    with av.open(str(tmp_path / "film.mp4")) as film:
        frames = list(film.decode(video=0))
    assert (len(frames), frames[0].width, frames[0].height) == (9, 160, 120)


def test_a_film_is_written_again_over_itself_and_there_and_back_is_longer(flat, ask):
    found = []
    for more in ((), ("--there-and-back",)):
        code, out, _ = ask("render", flat, "-o", "film.gif", *SMALL, *more, "--json")
        found.append(json.loads(out))
        assert code == 0
        with Image.open("film.gif") as film:
            assert film.n_frames == found[-1]["frames"]
    assert [one["frames"] for one in found] == [9, 16]
    assert found[0]["slow"] == 5.0
    assert found[0]["motion_s"] == pytest.approx(0.16)


def test_pictures_of_one_instant_and_of_several_differ(flat, ask):
    for name, more in (("one.png", ("--at-s", "0.08")), ("several.png", ("--instants", "4"))):
        code, out, _ = ask("render", flat, "-o", name, "--size-px", "160x120", *more)
        assert code == 0
        assert "160x120" in out
    with Image.open("one.png") as one, Image.open("several.png") as several:
        assert one.size == several.size == (160, 120)
        assert one.tobytes() != several.tobytes()


@pytest.mark.skipif(os.name != "posix", reason="signals are sent as POSIX has them")
@pytest.mark.usefixtures("default_signals")
def test_an_interrupt_ends_a_film_within_a_frame_and_leaves_nothing(flat, ask, monkeypatch, tmp_path):
    drawn = []

    def noted(*_: object) -> list:
        drawn.append(1)
        if len(drawn) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return []

    monkeypatch.setattr(render_module, "frame_lines", noted)
    before = sorted(tmp_path.iterdir())
    code, out, err = ask("render", flat, "-o", "film.mp4", *SMALL)
    assert (code, out) == (130, "")
    assert err.endswith("linkplan render: interrupted; nothing was written\n")
    assert len(drawn) == 3
    assert sorted(tmp_path.iterdir()) == before


def test_a_screen_that_cannot_be_opened_is_said_at_once_with_what_to_do_instead(ask, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for display in (None, ":7777"):
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        monkeypatch.delenv("DISPLAY", raising=False)
        if display:
            monkeypatch.setenv("DISPLAY", display)
        code, out, err = ask("view", "knee-reach")
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "screen" in err
        assert "render" in err
        assert "report" in err


def test_the_viewers_keys_stand_in_its_help(ask):
    _, out, _ = ask("view", "--help")
    assert all(f"{name} {does}" in " ".join(out.split()) for name, does, _ in KEYS.values())


def test_a_run_with_more_gain_follows_more_closely():
    plan = optimal("knee-reach")
    make, start = run_maker(plan), Controls(tracker="pd", slowness=4.0)
    more = start
    for _ in range(4):
        more = pressed(more, next(number for number, row in KEYS.items() if row[0] == "7"))
    runs = [make(controls) for controls in (start, more)]
    goal = plan.trajectory.position_at(runs[0].time_s)[:, 0]
    errors = [abs(run.pose[:, plan.problem.mechanism.independent[0]] - goal).max() for run in runs]
    assert errors[1] < 0.8 * errors[0]
    assert ("kp", "488.3  (x2.44)") in runs[1].words(3)
