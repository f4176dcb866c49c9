"""Verdicts: data that a caller asks, a sentence that follows from them, and the same after a plan was saved."""

import json

import msgspec
import pytest

import linkplan
from linkplan.planner.plan.verdict import Overrun, Verdict, failed, infeasible, out_of_time
from tests.support.plans import planned

OVER = Overrun(limit="effort", name="act_O", value=130.0, bound=100.0, unit="N.m", time_s=0.02)


@pytest.mark.parametrize(
    ("verdict", "sentence"),
    [
        (Verdict(kind="optimal", words="motion of 1 s", objective="effort"), "locally effort-optimal motion of 1 s"),
        (Verdict(kind="optimal", words="motion of 1 s", objective="time", is_global=True), "time-optimal motion of 1 s"),
        (Verdict(kind="feasible", words="motion of 1 s", objective="time"), "motion of 1 s"),
        (infeasible("too weak", overruns=(OVER,)).adding("in 2 s it does", ""), "infeasible: too weak; in 2 s it does"),
        (failed("nothing was found"), "failed: nothing was found"),
        (out_of_time(3.0), "failed: the solver ran out of its 3 s (solver.max_time_s)"),
    ],
)
def test_the_sentence_of_a_verdict_follows_from_its_data(verdict, sentence):
    assert verdict.sentence == sentence
    assert msgspec.json.decode(msgspec.json.encode(verdict), type=Verdict) == verdict


def test_a_caller_asks_a_plan_why_there_is_no_motion():
    plan = linkplan.plan(linkplan.Problem.from_file("knee-reach", {"motion.duration_s": 0.1}))
    with pytest.raises(linkplan.LinkplanError) as raised:
        plan.require()
    verdict = raised.value.verdict
    assert (verdict.kind, verdict.overruns[0].limit, verdict.overruns[0].name) == ("infeasible", "effort", "act_O")
    assert abs(verdict.overruns[0].value) > abs(verdict.overruns[0].bound) == 100.0
    assert 0.1 < verdict.remedy["motion.duration_s"] < 0.16
    said = json.loads(json.dumps(plan.to_dict()))
    assert said["verdict"]["remedy"] == verdict.remedy
    assert said["message"] == verdict.sentence


def test_a_reference_that_is_too_fast_has_the_frequency_that_would_do():
    plan = linkplan.plan(linkplan.Problem.from_file("knee-sine", {"mechanism.payload": "shank"}))
    verdict = plan.verdict
    assert (verdict.kind, verdict.known_by) == ("infeasible", "reference")
    eased = linkplan.plan(linkplan.Problem.from_file("knee-sine", {"mechanism.payload": "shank"} | verdict.remedy))
    assert eased.passed


def test_a_saved_plan_has_the_verdict_that_it_had(tmp_path):
    plan = linkplan.Plan.of(planned("knee-reach"))
    plan.save(tmp_path / "plan")
    assert linkplan.read_plan(tmp_path / "plan").verdict == plan.verdict
