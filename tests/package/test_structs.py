"""Every result of a study is one struct: its JSON is read back as the same struct, and no function describes it again."""

import importlib
import json
from typing import get_origin

import msgspec
import pytest

import linkplan
from linkplan.planner.files.folders import plain_record
from linkplan.planner.files.structs import Beside, read_value
from linkplan.studies.handover.export import c_files
from linkplan.studies.output.result import Result
from linkplan.studies.output.text import text_of
from tests.support.phases import HOPPER, TOE
from tests.support.sources import MODULES

COARSE = {"tracking.period_s": 1e-3, "tracking.kp": 200.0, "tracking.kd": 1.0}
VARIED = {"payload_mass_factor": [0.9, 1.1], "delay_periods": [0.0, 2.0]}
AT_REST = {"at_deg": [{"O": 3.6}], "period_s": 1e-4}
LOCKED = """<mujoco><worldbody><body name="b"><joint axis="0 1 0"/><geom size=".1"/></body></worldbody>
  <equality><weld body1="b"/></equality></mujoco>"""
# One does, and one is too weak.
MOTORS = [{"name": "M", "peak_effort": 90.0, "rms_effort": 60.0, "rotor_inertia": 1e-3}, {"name": "N", "peak_effort": 1.0}]
# Results of every kind, with the optional parts of their structs.
JUMP = [linkplan.Phase("push", on=["toe"], start_m={"leg": 0.0}), linkplan.Phase("flight", goal_m={"leg": 0.3})]
APEX = {"com_height": "apex"}
TURN = {"goal_deg": {"O": 60.0}}
MADE = {
    "check": ("WholeCheck", lambda _: linkplan.check("slider-crank", at_deg=[{"O": 30.0}])),
    "check of contacts": (
        "WholeCheck",
        lambda _: linkplan.check(linkplan.Problem.phases(HOPPER, JUMP, contacts=TOE, objective={"maximize": APEX})),
    ),
    "check of a locked model": ("RefusedModel", lambda _: linkplan.check(LOCKED)),
    "plan in phases": (
        "PhasedPlan",
        lambda _: linkplan.plan(linkplan.Problem.phases("slider-crank", [linkplan.Phase("turn", duration_s=0.5, **TURN)])),
    ),
    "track, on the ground": (
        "GroundTracking",
        lambda _: linkplan.track(linkplan.Problem.phases(HOPPER, JUMP, contacts=TOE, objective={"maximize": APEX}), "lqr"),
    ),
    "track": ("TrackingResult", lambda plan: linkplan.track(plan, "lqr")),
    "compare": ("TrackingResult", lambda plan: linkplan.compare(plan, ["pd", "lqr"])),
    "bode": ("BodeStudy", lambda _: linkplan.bode("optimus-knee", kp=200.0, kd=20.0, measure=False, **AT_REST)),
    "bode, measured": (
        "BodeStudy",
        lambda _: linkplan.bode("optimus-knee", kp=200.0, kd=20.0, frequency_hz=[100.0], **AT_REST),
    ),
    "bode, a plant": (
        "PlantStudy",
        lambda _: linkplan.bode(
            "optimus-knee", kp=200.0, kd=1.0, frequency_hz=[100.0], from_effort=["act_O"], to_position=["C"], **AT_REST
        ),
    ),
    "tune": ("Tuning", lambda _: linkplan.tune("optimus-knee", bandwidth_hz=10.0, **AT_REST)),
    "tune, several joints": (
        "Tuning",
        lambda _: linkplan.tune("five-bar", bandwidth_hz=10.0, tracker="pd", stiffness=5.0),
    ),
    "transfer": ("TransferResult", lambda _: linkplan.transfer("optimus-knee", ["C"])),
    "experiment": (
        "ExperimentOutcome",
        lambda plan: linkplan.experiment(plan, ["pd", "lqr"], samples=16, imperfections=VARIED),
    ),
    "batch": ("BatchOutcome", lambda _: linkplan.batch({"problem": "knee-reach", "case": [{"name": "one", "set": []}]})),
    "size": ("Sizing", lambda _: linkplan.size("knee-reach", MOTORS)),
    "decompose": ("Decomposition", lambda plan: linkplan.decompose(plan, ["pd"], imperfections=VARIED, samples=2)),
}
# Its JSON is that of a `Proof` of the planner.
OF_THE_PLANNER = {"ProofResult"}


@pytest.fixture(scope="module")
def plan():
    return linkplan.plan(linkplan.Problem.from_file("knee-reach", COARSE)).require()


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_the_json_of_a_result_is_read_back_as_its_struct(plan, name):
    kind, make = MADE[name]
    result = make(plan)
    assert isinstance(result, Result)
    assert type(result).__name__ == kind
    assert repr(result).startswith(f"{kind}(")
    said = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    again = msgspec.convert(said, type(result.struct), dec_hook=read_value)
    assert plain_record(again) == said
    beside = [one.name for one in msgspec.structs.fields(again) if get_origin(one.type) is Beside]
    assert all(getattr(again, key) is None for key in beside)
    if set(beside) <= {"plan"}:  # only the report needs the plan
        assert text_of(again.blocks()) == text_of(result.blocks())


def test_the_certificate_and_the_history_in_plan_json_are_the_plan_s_own_structs(plan):
    said, certificate = plan.to_dict(), plan.certificate
    assert (plan.struct.certificate, plan.struct.history) == (certificate, plan.history)
    assert said["certificate"]["joint_margin_deg"] == certificate.joint_margin_deg
    assert set(said["certificate"]["joint_margin_deg"]) == {"O", "A", "C"}
    assert not said["certificate"]["joint_margin_m"]
    assert [one["left"] for one in said["certificate"]["margins"]] == [one.left for one in certificate.margins]
    assert "growth" not in said["certificate"]
    assert [one["objective"] for one in said["history"]] == [step.objective for step in plan.history]


@pytest.mark.parametrize("make", [
    lambda _plan, _place: linkplan.new("slider-crank"),
    lambda plan, place: linkplan.export(plan, place / "reach.csv", "csv"),
    lambda plan, place: linkplan.export(plan, place / "law", "c"),
    lambda plan, place: linkplan.export(plan.problem.mechanism, place / "model", "c"),
], ids=["new", "a file", "a law in C", "a model in C"])  # fmt: skip
def test_the_json_of_what_is_no_result_is_read_back_as_its_struct(make, plan, tmp_path, monkeypatch):
    monkeypatch.setattr(c_files, "COMPILERS", {})
    shown = make(plan, tmp_path)
    assert isinstance(shown, msgspec.Struct)
    assert not isinstance(shown, Result)
    said = json.loads(json.dumps(shown.to_dict(), allow_nan=False))
    assert plain_record(msgspec.convert(said, type(shown))) == said
    assert str(shown) == text_of(shown.blocks())
    assert "<p" in shown._repr_html_()


def test_every_kind_of_result_is_a_struct_and_tried_above():
    for module in MODULES:
        importlib.import_module(module)
    every, kinds = [Result], {}
    while every:
        kind = every.pop()
        every += kind.__subclasses__()
        if not kind.__subclasses__() and kind.__name__ not in OF_THE_PLANNER:
            kinds[kind.__name__] = kind
    assert {kind for kind, _ in MADE.values()} == set(kinds)
    assert not [name for name, kind in kinds.items() if "to_dict" in vars(kind)]
