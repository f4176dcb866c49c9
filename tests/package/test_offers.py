"""What the command line does, from Python: reports, films, exports, first problems, batches; notebooks' tables."""

import re

import control
import numpy as np
import pytest
from PIL import Image

import linkplan
from tests.support.plans import optimal
from tests.support.refusals import assert_refused


@pytest.fixture(scope="module")
def plan():
    return linkplan.Plan.of(optimal("knee-reach"))


@pytest.fixture(scope="module")
def loop():
    return linkplan.bode("knee-reach", measure=False, at_deg=[{"O": 0.0}, {"O": 20.0}])


def test_every_result_has_a_report(plan, loop, tmp_path):
    results = {"plan": plan, "bode": loop, "check": linkplan.check("five-bar"), "folder": plan.save(tmp_path / "saved")}
    results["tracked"] = linkplan.track(plan, "pd+ff", tracking={"duration_s": 0.01})
    for name, result in results.items():
        place = linkplan.report(result, tmp_path / f"{name}.html")
        assert place.read_text(encoding="utf-8").startswith("<!doctype html>"), name
    assert_refused(lambda: linkplan.report(7, tmp_path / "seven.html"), "a report takes a result")


@pytest.mark.slow
def test_a_picture_is_rendered(plan, tmp_path):
    done = linkplan.render(plan, tmp_path / "reach.png", at_s=0.08, size_px=(160, 120))
    assert Image.open(tmp_path / "reach.png").size == done.struct.size == (160, 120)
    assert_refused(lambda: linkplan.render(plan, tmp_path / "reach.bmp"), "end in .mp4")


def test_a_plan_is_exported(plan, tmp_path):
    place = linkplan.export(plan, tmp_path / "reach.csv", "csv", every_s=0.01).path
    assert len(place.read_text(encoding="utf-8").splitlines()) == 1 + 17
    assert_refused(lambda: linkplan.export(plan, tmp_path / "reach.cvs", "cvs"), "unknown format 'cvs'")


def test_new_is_a_problem_with_its_file_and_plan(tmp_path):
    first = linkplan.new("slider-crank", tmp_path / "first.toml")
    assert first.planned
    assert first.text == (tmp_path / "first.toml").read_text(encoding="utf-8")
    assert linkplan.Problem.from_file(tmp_path / "first.toml").motion.kind == first.problem.motion.kind
    assert_refused(lambda: linkplan.new("slider-crank", tmp_path / "first.toml"), "first.toml")


def test_new_puts_motors_on_joints_as_its_refusal_offers():
    arm = """<mujoco><worldbody><body><joint name="arm" axis="0 1 0" actuatorfrcrange="-9 9"/>
      <geom size="0.05" pos="0.1 0 0"/></body></worldbody></mujoco>"""
    assert_refused(lambda: linkplan.new(arm), 'mechanism.drive = ["arm"]')
    assert linkplan.new(arm, drive=["arm"]).planned


def test_a_batch_is_a_table_of_numbers_and_its_plans():
    durations = linkplan.batch({"problem": "knee-reach", "sweep": {"motion.duration_s": [0.16, 0.2, 0.01]}})
    assert not durations.passed
    assert len(durations.failures) == 1
    found = durations.to_dict()["cases"]
    assert [case["status"] for case in found.values()] == ["optimal", "optimal", "infeasible"]
    assert durations._repr_html_().count("<tr>") == 4
    assert [plan.status for plan in durations.plans] == ["optimal", "optimal", "infeasible"]
    assert durations.plans[1].sample(0.1).time_s == 0.1
    assert durations.plans[-1].verdict.remedy["motion.duration_s"] > 0.01
    assert [plan.duration_s for plan in durations.plans[:2]] == pytest.approx([0.16, 0.2])
    pytest.importorskip("pandas")
    frame = durations.to_frame()
    assert list(frame["motion.duration_s"]) == [0.16, 0.2, 0.01]
    assert list(frame["peak effort [N.m]"][:2]) == pytest.approx(
        [plan.certificate.peak_effort[0] for plan in durations.plans[:2]], rel=1e-3
    )
    known = [plan.objective for plan in durations.plans[:2]]
    assert list(frame["objective [N2 m2 s]"][:2]) == pytest.approx(known, rel=1e-5)
    assert_refused(lambda: linkplan.batch({"problem": "knee-reach"}), "a batch must have")


def test_a_loop_is_systems_of_python_control(loop):
    system = loop.lti(loop.poses[1])
    assert isinstance(system, control.StateSpace)
    assert system.dt == 1e-4
    data = loop.frd("loop", loop.poses[1])
    for k in (0, 300, len(data.omega) - 1):
        assert system(np.exp(1j * data.omega[k] * system.dt)) == pytest.approx(data.frdata[0, 0, k], rel=1e-9)
    assert np.abs(loop.lti(closed=True).poles()).max() < 1
    sensitivity = loop.frd("sensitivity", loop.poses[1])
    np.testing.assert_allclose(sensitivity.frdata * (1 + data.frdata), np.ones_like(data.frdata), rtol=1e-9)
    assert_refused(lambda: loop.frd(measured=True), "'loop' was not measured")


def test_builders_take_reserve_ranges_and_imperfections():
    asked = {"start_deg": {"O": -20}, "goal_deg": {"O": 20}, "duration_s": 0.2}
    more = {"reserve": 0.2, "robust": {"torque_constant_factor": [0.9, 1.1]}, "imperfections": {"delay_periods": [0.5, 2.0]}}
    problem = linkplan.Problem.reach("optimus-knee", limits={"effort": {"act_O": [-50, 50]}}, **asked, **more)
    assert problem.limits.reserve == 0.2
    assert problem.limits.effort[0].tolist() == pytest.approx([-40.0, 40.0])
    assert problem.robust.torque_constant_factor == [0.9, 1.1]
    assert problem.to_dict()["imperfections"] == {"delay_periods": [0.5, 2.0]}
    assert problem.replace(reserve=None).limits.reserve == 0.0
    for key, wrong in (("reserve", 2.0), ("robust", {"payload": 1}), ("imperfections", {"delay": 1})):
        with pytest.raises(linkplan.LinkplanError):
            linkplan.Problem.reach("optimus-knee", **asked, **{key: wrong})


def test_results_are_tables_in_notebooks(plan, loop):
    for result, words in ((plan, "certificate: passed"), (loop, "phase margin"), (linkplan.check("five-bar"), "five-bar")):
        text = result._repr_html_()
        assert words in text
        assert not re.search(r"<(script|img)", text)
