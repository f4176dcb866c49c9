"""Tracking of motions in phases with real contacts on the ground, and the stability of gaits."""

import json
from pathlib import Path

import numpy as np
import pytest

import linkplan
from linkplan.controllers.phases.jumps import cycle_map
from linkplan.controllers.phases.law import Exchanged, PhasedLaw, Stage
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.pd import pd
from linkplan.controllers.trackers.tracker import Memoryless
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.compare import design_of
from linkplan.studies.compare.on_ground import ground_motion, jumps_of
from tests.support.phases import ARM, HOPPER, LOAD, SIMPLEST, TOE, step

JUMP = [linkplan.Phase("push", on=["toe"], start_m={"leg": 0.0}), linkplan.Phase("flight", goal_m={"leg": 0.3})]
BOTH_DRIVEN = SIMPLEST.replace("<actuator>", '<actuator><motor name="other" joint="st" ctrlrange="-1 1"/>')


@pytest.fixture(scope="module")
def jump():
    asked = linkplan.Problem.phases(HOPPER, JUMP, contacts=TOE, objective={"maximize": {"com_height": "apex"}})
    return linkplan.plan(asked).require()


def test_a_hopper_with_real_contacts_jumps_almost_as_high_as_planned(jump):
    tracked = linkplan.compare(jump, ["pd+ff", "lqr"], mass_factor=1.0, delay_periods=0)
    assert tracked.passed
    for run in tracked.runs.values():
        assert run.apex_m == pytest.approx(0.6813266365, rel=0.01)
        assert run.peak_force_n["sole"] == pytest.approx(300.0 + 2.0 * 9.81, rel=0.01)
        assert [one.measured_s for one in run.phases] == pytest.approx([0.0, 0.1374], abs=1e-3)


def test_a_heavier_body_jumps_lower(jump):
    assert linkplan.track(jump, "pd+ff", mass_factor=1.2).runs["pd+ff"].apex_m < 0.6


def test_a_saved_jump_is_tracked_like_the_plan_and_written_with_its_forces(jump, tmp_path):
    jump.save(tmp_path / "jump")
    tracked = linkplan.track(tmp_path / "jump", "lqr")
    assert tracked.runs["lqr"].apex_m == pytest.approx(linkplan.track(jump, "lqr").runs["lqr"].apex_m, rel=1e-6)
    tracked.save(tmp_path / "run")
    head = (tmp_path / "run/nominal-lqr.csv").read_text(encoding="utf-8").splitlines()[0]
    assert {"sole force_N", "com_z_m", "leg_applied_N"} <= set(head.replace('"', "").split(","))
    assert json.loads((tmp_path / "run/track.json").read_text(encoding="utf-8"))["apex_m"] == pytest.approx(0.68132663)


def test_loads_that_change_are_not_tracked_on_the_ground():
    phases = [linkplan.Phase("approach", goal_deg={"J": 30.0}), linkplan.Phase("carry", payload=LOAD, goal_deg={"J": 60.0})]
    carry = linkplan.plan(linkplan.Problem.phases(ARM, phases, motion={"duration_s": 1.0}))
    with pytest.raises(ProblemError, match="phase carry changes them"):
        linkplan.track(carry, "lqr")


@pytest.mark.slow
def test_a_walker_with_real_contacts_walks_with_lqr_and_falls_with_pd_as_its_multipliers_say():
    tracked = linkplan.compare(step(0.8, distance_m=0.5), ["pd", "lqr"], mass_factor=1.0, delay_periods=0)
    walks, falls = tracked.runs["lqr"], tracked.runs["pd"]
    assert walks.multiplier < 0.2
    assert walks.passed
    assert walks.distance_m == pytest.approx(2.5, rel=0.02)
    assert walks.slip_m < 2e-3
    assert [one.measured_s for one in walks.phases] == pytest.approx(0.7 * np.arange(5), abs=0.005)
    assert falls.multiplier > 2.0
    assert not falls.passed


@pytest.mark.slow
def test_the_simplest_walker_has_the_printed_multipliers():
    # Garcia, Chatterjee, Ruina & Coleman, J. Biomech. Eng. 120 (1998): without feedback, feet without mass.
    angle = 0.200310900544287
    tables = {
        "contacts": {"foot": {"site": "st_foot", "friction": 2.0}},
        "motion": {"repeat": True, "mirror": {"st": "sw"}, "distance_m": 2.0 * np.sin(angle)},
        "mechanism": {"model": BOTH_DRIVEN, "independent": ["st", "sw"]},
    }
    asked = linkplan.planner.problem.phases.PhasedProblem.from_tables(
        "simplest", tables | {"phases": [{"name": "step", "on": ["foot"]}]}
    )
    motion = ground_motion(linkplan.plan(asked))
    (design,) = [design_of(plan, one) for plan, one in zip(motion.plans, motion.references, strict=True)]
    passive = pd(design.mechanism, design.reference, 0.0, 0.0)
    found = np.linalg.eigvals(cycle_map([design], [passive], jumps_of(motion), [motion.record.duration_s]))
    printed = complex(-0.190099639402167, 0.557599274284362)
    assert np.abs(found - printed).min() < 0.002
    assert np.abs(found - 1.0).min() < 0.002  # a start later is no error


def test_the_slider_crank_leg_jumps_as_high_as_planned():
    leg = (Path(__file__).parents[2] / "data/slider-crank-leg.xml").read_text(encoding="utf-8")
    asked = linkplan.Problem.phases(
        leg,
        [linkplan.Phase("push", on=["toe"], start_deg={"hip": 0.0}), linkplan.Phase("flight")],
        contacts={"toe": {"site": "foot", "friction": 1.5}},
        objective={"maximize": {"com_height": "apex"}},
    )
    plan = linkplan.plan(asked).require()
    assert linkplan.track(plan, "lqr").runs["lqr"].apex_m == pytest.approx(plan.body.apex_m, rel=0.02)


def law(touching, exchanged=None):
    """Return a law of one phase of 10 instants, whose effort is the first position, 2 joints and feet."""

    class Echo:
        name = "echo"

        def effort(self, _, position_rad, __):
            return position_rad

    many = np.zeros((10, 2))
    reference = SampledReference(
        period_s=1.0, time_s=np.arange(10.0), pose_rad=many, position_rad=many, velocity_rad_s=many, effort=many, cycle=None
    )
    stage = Stage(
        law=Memoryless(law=Echo(), batched=False),
        reference=reference,
        independent=np.arange(2),
        touching=np.array(touching),
    )
    return PhasedLaw(name="echo", stages=(stage,), exchanged=exchanged)


SWAP = Exchanged(joints=np.array([1, 0]), actuators=np.array([1, 0]), feet=np.array([1, 0]), moved=np.array([3.0, 3.0]))


@pytest.mark.parametrize(("touches_at", "ends_at"), [(3, 8), (9, 9), (11, 11), (30, 12)])
def test_a_phase_ends_at_the_measured_contact_within_a_fifth_of_its_duration(touches_at, ends_at):
    forces = np.zeros((16, 2))
    forces[touches_at:, 1] = 5.0
    phases, _ = law([False, True], SWAP).phases_of(forces)
    assert np.flatnonzero(phases)[0] == ends_at


def test_after_a_step_the_legs_have_exchanged_their_joints_and_actuators():
    tracker, pose = law([False, True], SWAP), np.array([[1.0, 2.0]])
    memory = tracker.start(1)
    for _ in range(9):
        effort, memory = tracker.step(0, pose, np.array([[0.0, 0.0, 5.0, 0.0]]), memory)
        assert effort.tolist() == [[1.0, 2.0]]
    effort, memory = tracker.step(0, pose, np.array([[0.0, 0.0, 5.0, 5.0]]), memory)
    assert memory[0, :2].tolist() == [1.0, 1.0]
    # Seen as the other leg's, less the way of the origin, and given to the other leg's actuator.
    assert effort.tolist() == [[1.0 - 3.0, 2.0 - 3.0]]
