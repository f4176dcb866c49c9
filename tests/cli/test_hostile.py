"""Hostile input: nonsense is refused in one line, what is too large before it is asked for, and nothing escapes."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from linkplan.cli import main as program
from linkplan.models.compiled import functions
from linkplan.models.errors import CertificateError, ModelError, PlanFileError, ProblemError, one_line
from linkplan.models.library import built_in_text
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.files import tables
from linkplan.planner.plan.folder import read_plan
from linkplan.planner.problem.problem import load_problem
from linkplan.studies.output.figure import page
from tests.bench.fuzz import fuzz
from tests.support.plans import saved_plan
from tests.support.refusals import assert_refused

CRANK = built_in_text("slider-crank")
BAR = """<mujoco><option timestep="1e-3"/><worldbody><body name="bar"><joint name="h" axis="0 1 0" {joint}/>
<geom size="0.1" mass="1"/></body></worldbody><actuator><motor name="m" joint="h" {motor}/></actuator>{more}</mujoco>"""


def bar(joint: str = "", motor: str = "", more: str = "") -> str:
    return BAR.replace("{joint}", joint).replace("{motor}", motor).replace("{more}", more)


def test_a_bar_that_is_as_it_should_be_is_read():
    assert load_mechanism(bar()).dof == 1


NONSENSE = {
    "negative armature": (bar(joint='armature="-1"'), "armature"),
    "infinite gear": (bar(motor='gear="inf"'), "not finite"),
    "negative timestep": (bar(more='<option timestep="-1"/>'), "timestep"),
    "negative damping": (bar(joint='damping="-1"'), "damping"),
    "infinite gravity": (bar(more='<option gravity="0 0 inf"/>'), "not finite"),
    "escape in a name": (bar().replace('"bar"', '"&#27;[31m"'), ""),
    "an endless name": (bar().replace('"bar"', '"' + 600 * "a" + '"'), "600 characters"),
    "a million copies": (bar(more='<worldbody><replicate count="1000000"><site/></replicate></worldbody>'), "count"),
    "a huge field": (bar(more='<asset><hfield name="f" nrow="100000" ncol="9" size="1 1 1 1"/></asset>'), "nrow"),
    "huge stack": (bar(more='<size nstack="900000000"/>'), "nstack"),
}


@pytest.mark.filterwarnings("error")  # a warning beside the refusal would be a second line
@pytest.mark.parametrize("case", NONSENSE)
def test_a_model_of_nonsense_is_refused_in_one_line(case):
    text, word = NONSENSE[case]
    with pytest.raises(ModelError) as refused:
        load_mechanism(text)
    assert word in str(refused.value)
    assert str(refused.value).isprintable()


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.xml")
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "includes.xml").write_text(bar(more='<include file="pipe.xml"/>'))
    (tmp_path / "draws.xml").write_text(bar(more='<asset><mesh name="m" file="pipe.stl"/></asset>'))
    for name in ("pipe.xml", "includes.xml", "draws.xml"):
        with pytest.raises(ModelError, match="regular file"):
            load_mechanism(tmp_path / name)


def test_names_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "a.xml").write_bytes(bar().replace('"bar"', '"b\u00e4r"').encode("latin-1"))
    assert_refused(lambda: load_mechanism(tmp_path / "a.xml"), "UTF-8", kind=ModelError)


def test_a_mark_that_editors_put_before_the_text_is_no_part_of_it(tmp_path):
    text = tables.built_in_text("knee-reach")
    (tmp_path / "a.toml").write_text(text, encoding="utf-8-sig", newline="\r\n")
    assert (tmp_path / "a.toml").read_bytes().startswith(b"\xef\xbb\xbf")
    assert load_problem(tmp_path / "a.toml").motion.kind == "reach"


@pytest.mark.parametrize("content", ["a = " + "[" * 5000, "a = " + "9" * 5000, "[a" + ".a" * 5000 + "]\nb=1"])
def test_toml_that_breaks_its_reader_is_refused(content, tmp_path):
    (tmp_path / "a.toml").write_text(content)
    assert_refused(lambda: load_problem(tmp_path / "a.toml"), kind=ProblemError)


@pytest.mark.parametrize("line", [["--frequency-hz", "1e-5,10"], ["--period-s", "1e9"]])
@pytest.mark.slow
def test_bode_refuses_what_does_not_fit_into_memory(line, ask):
    code, out, err = ask("bode", "optimus-knee", "--at-deg", "0", *line)
    assert (code, out) == (2, "")
    assert "at most" in err or "period" in err


def test_a_rod_without_mass_is_a_problem():
    light = CRANK.replace('mass="0.2"', 'mass="1e-9"')
    assert light != CRANK
    whole = load_mechanism(light)
    from linkplan.studies.check.inspection import inspect

    assert any("mass" in said for said in inspect(whole, []).problems)
    assert not any("mass" in said for said in inspect(load_mechanism("slider-crank"), []).problems)


@pytest.mark.usefixtures("drawn_figures")
def test_a_name_of_dollars_is_drawn_as_it_stands(tmp_path):
    with page(tmp_path / "a.png") as axes:
        axes[0, 0].set_title("joint $x^$")
    assert (tmp_path / "a.png").stat().st_size > 0


def test_a_refusal_has_no_character_that_a_terminal_obeys():
    assert one_line("a\x1b[2J\udce9\nb").isprintable()


def test_an_unclosed_quote_in_cc_is_no_compiler(monkeypatch):
    monkeypatch.setenv("CC", 'gcc "')
    functions.compiler.cache_clear()
    try:
        assert functions.compiler() is None
    finally:
        functions.compiler.cache_clear()


def test_what_nobody_foresaw_is_one_line_and_a_file(ask, monkeypatch, tmp_path):
    from linkplan.cli import commands

    def fails(_arguments):
        raise ZeroDivisionError("oh")

    monkeypatch.setattr(commands, "run_list", fails)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", None)
    code, out, err = ask("list")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "ZeroDivisionError" in err
    assert "oh" in next(tmp_path.iterdir()).read_text(encoding="utf-8")
    assert program.main(["--version"]) == 0


# A saved plan is certified again.


def edited(folder: Path, **changes) -> Path:
    said = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    (folder / "plan.json").write_text(json.dumps(said | changes), encoding="utf-8")
    return folder


def scaled(folder: Path, name: str, factor: float) -> Path:
    with np.load(folder / "trajectory.npz") as stored:
        arrays = dict(stored)
    arrays[name] = factor * arrays[name]
    np.savez(folder / "trajectory.npz", **arrays)
    return folder


CHANGED = {
    "status": lambda folder: edited(folder, status="failed"),
    "objective": lambda folder: edited(folder, objective=300.0),
    "effort": lambda folder: scaled(folder, "effort", 0.5),
    "duration": lambda folder: scaled(folder, "breaks_s", 1.01),
}


@pytest.mark.parametrize("what", CHANGED)
def test_a_plan_that_does_not_pass_is_refused_or_run_anyway_with_exit_one(what, tmp_path, ask):
    folder = CHANGED[what](saved_plan("knee-reach", tmp_path))
    assert_refused(lambda: read_plan(folder), kind=CertificateError)
    assert read_plan(folder, anyway=True).status == "failed"
    code, out, err = ask("track", str(folder))
    assert (code, out) == (1, "")
    assert "not used" in err.splitlines()[-1]
    code, out, err = ask("track", str(folder), "--anyway")
    assert code == 1
    assert "run anyway" in err
    assert out


@pytest.mark.parametrize("factor", [1e-200, 1e200])
def test_a_plan_of_a_duration_whose_square_is_no_float_is_refused(factor, tmp_path):
    folder = scaled(saved_plan("knee-reach", tmp_path), "breaks_s", factor)
    assert_refused(lambda: read_plan(folder), kind=PlanFileError)


def test_an_array_that_declares_more_than_it_may_is_refused_before_it_is_read(tmp_path):
    folder = saved_plan("knee-reach", tmp_path)
    names = ("breaks_s", "position", "velocity", "effort", "start_pose", "periodic")
    np.savez_compressed(folder / "trajectory.npz", **{name: np.zeros(9_000_000) for name in names})
    assert (folder / "trajectory.npz").stat().st_size < 1_000_000
    assert_refused(lambda: read_plan(folder), "bytes", kind=PlanFileError)


@pytest.mark.slow
def test_no_hostile_input_of_a_sample_gets_through(tmp_path):
    found = fuzz(list(range(24)), 12, saved_plan("knee-reach", tmp_path))
    assert len(found) == 24
    assert not [outcome for outcome in found if outcome.wrong]
    shutil.rmtree(tmp_path, ignore_errors=True)
