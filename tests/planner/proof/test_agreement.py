"""Certificate and proof give one answer: the same claims and allowances, on samples and at every instant."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from msgspec import structs

import linkplan
from linkplan.planner.certificate.certificate import Certificate, certify
from linkplan.planner.closed_chain.case import case_of
from linkplan.planner.limits.efforts import INVERSE_DYNAMICS_SHARE
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.ends import end_findings
from linkplan.planner.proof.motion import Piece
from linkplan.planner.proof.prove import prove
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.bernstein import PiecewisePolynomial
from tests.bench.random_fourbars import random_case
from tests.support.bodies import HINGE, HINGE_INERTIA, QUARTER_TURN, body_problem
from tests.support.linkage_problems import drawn
from tests.support.motions import motion_along
from tests.support.provable import limited, peak, swing

# A crank that a piston drives; on its way from -22 to 23 deg it passes a dead centre, where no effort turns it.
PISTON = """<mujoco><option timestep="1e-4"/>
<default><joint axis="0 -1 0" damping="0.002"/><geom type="capsule" size="0.008" density="3000" contype="0" conaffinity="0"/>
</default>
<worldbody>
  <body name="crank"><joint name="crank"/><geom fromto="0 0 0 0.05 0 0"/>
    <geom type="cylinder" size="0.08 0.01" euler="90 0 0" density="3000"/>
    <body name="rod" pos="0.05 0 0"><joint name="rod"/><geom fromto="0 0 0 0.15 0 0"/><site name="end" pos="0.15 0 0"/>
    </body>
  </body>
  <body name="piston" pos="0.2 0 0"><joint name="piston" type="slide" axis="1 0 0" damping="1"/>
    <geom type="box" size="0.02 0.02 0.02" mass="0.4"/><site name="pin"/></body>
</worldbody>
<equality><connect name="P" site1="end" site2="pin"/></equality>
<actuator><motor name="gas" joint="piston" ctrlrange="-400 400"/></actuator></mujoco>"""


def past_a_dead_centre(*overrides: str) -> Problem:
    ends = 'kind = "reach"\nstart_deg = { crank = -22 }\ngoal_deg = { crank = 23 }\nduration_s = 0.1\n'
    return body_problem(PISTON, ends, 'mechanism.independent=["crank"]', 'objective.minimize="effort"', *overrides)


@pytest.mark.parametrize("beyond", [-4e-6, 4e-6])
@pytest.mark.parametrize("seed", range(2))
def test_both_refuse_an_effort_by_inverse_dynamics_just_beyond_its_mark(seed, beyond):
    problem, motion = swing(seed)
    within = limited(problem, peak(problem.mechanism, motion) / (1 + INVERSE_DYNAMICS_SHARE + beyond))
    refuted = [one.name for one in prove(within, motion, existence=False).of("refuted")]
    assert any("by inverse dynamics" in name for name in refuted) is (beyond > 0)
    assert bool(certify(within, motion).needs_more) is (beyond > 0)


def test_an_effort_by_inverse_dynamics_beyond_its_mark_fails_the_certificate_but_does_not_end_the_refinement():
    problem, motion = swing(0)
    within = limited(problem, 0.99 * peak(problem.mechanism, motion))
    certificate = certify(within, motion)
    only = structs.replace(certificate, failures=(certificate.needs_more,))
    assert "between nodes the motion needs" in certificate.needs_more
    assert not only.passed
    assert case_of(within).error_report(only).passed
    assert not case_of(within).error_report(structs.replace(only, failures=(*only.failures, "another"))).passed


@pytest.mark.parametrize(("beyond", "passed"), [(1e-12, True), (1e-8, False)])
def test_a_planned_effort_beyond_its_limit_by_rounding_passes_both(beyond, passed):
    motion = motion_along([0.0, 1.0], np.radians([10.0, 10.0, 10.0]), effort=[[1.0]])
    problem = body_problem(HINGE, QUARTER_TURN + "duration_s = 1.0\n", f"limits.effort.motor=[-9, {1.0 - beyond!r}]")
    assert (certify(problem, motion).effort_excess == 0.0) is passed
    refuted = [one.name for one in prove(problem, motion, existence=False).of("refuted")]
    assert ("planned effort of motor" not in refuted) is passed


def slow(off: float = 0.0) -> Trajectory:
    """Return a turn at constant acceleration with a short second interval, where its velocity is wrong by a share `off`."""
    breaks, bend = np.array([0.0, 5e3, 5e3 + 1e-6, 1e4]), 2e-8
    begin, end = breaks[:-1], breaks[1:]
    position = 0.7 + bend / 2 * np.array([begin * begin, begin * end, end * end])[:, :, None]
    velocity = bend * np.array([begin, end])[:, :, None]
    velocity[:, 1] += off * velocity.max()
    return motion_along(breaks, position, velocity=velocity, effort=np.full((1, 3, 1), HINGE_INERTIA * bend))


@pytest.mark.parametrize(("off", "answer"), [(0.0, "proved"), (1e-3, "refuted")])
def test_the_rounding_of_positions_on_a_short_interval_is_no_difference_of_its_velocity(off, answer):
    motion, problem = slow(off), body_problem(HINGE, QUARTER_TURN + "duration_s = 1e4\n")
    slope = PiecewisePolynomial(motion.position, motion.breaks_s).derivative().coefficients
    assert np.abs(slope - motion.velocity).max() > 1e-8 * motion.velocity.max()  # by rounding alone, if not by `off`
    (found,) = [one for one in end_findings(problem, motion) if "velocity is the slope" in one.name]
    assert found.answer == answer
    said = [one for one in certify(problem, motion).failures if "the planned velocity is not" in one]
    assert bool(said) is (answer == "refuted")


def test_efforts_on_an_interval_that_amplifies_the_rounding_of_positions_follow_from_velocities():
    assert Piece.of(slow(), 1).kinetics == ("of_velocity",)
    assert Piece.of(slow(), 0).kinetics == ("of_position",)
    assert Piece.of(slow(1e-3), 1).kinetics == ("of_position", "of_velocity")


def test_a_motion_past_a_dead_centre_passes_both():
    plan = plan_motion(past_a_dead_centre("mesh.intervals=20"))
    assert plan.status == "optimal", plan.message
    proof = prove(plan.problem, plan.trajectory, existence=False)
    assert proof.complete, [one.sentence() for one in (*proof.of("refuted"), *proof.of("undecided"))]


def spoilt(problem: Problem, motion: Trajectory, angle: float) -> Certificate:
    """Return the certificate of a motion with a bend where its crank is at an angle [rad]."""
    position = np.array(motion.position)
    at = int(np.argmin(np.abs(position.mean(axis=0)[:, 0] - angle)))
    position[2:-2, at] += 1e-4
    velocity = PiecewisePolynomial(position, motion.breaks_s).derivative().coefficients
    return certify(problem, replace(motion, position=position, velocity=velocity))


def test_a_motion_past_a_dead_centre_at_home_passes_both_for_weaker_motors():
    plan = plan_motion(past_a_dead_centre("mesh.intervals=20", "robust.torque_constant_factor=[0.9,1]"))
    assert plan.status == "optimal", plan.message
    proof = plan.prove(existence=False)
    assert proof.complete, [one.sentence() for one in (*proof.of("refuted"), *proof.of("undecided"))]
    names = [one.name for one in proof.findings]
    assert "effort on crank that planned efforts lack at a dead centre with torque constant 0.9" in names


def test_efforts_that_a_motion_lacks_at_a_dead_centre_are_said_to_lack_there():
    plan = plan_motion(past_a_dead_centre("mesh.intervals=20"))
    for angle, named in ((0.0, True), (np.radians(15.0), False)):
        (said,) = [one for one in spoilt(plan.problem, plan.trajectory, angle).failures if "more effort than planned" in one]
        assert ("'gas' is near a dead centre there" in said) is named


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 3, 4, 10, 13, 17, 18, 24])
def test_plans_of_random_problems_get_one_answer_of_both(number):
    """Of 200 such problems, all 180 that have a motion pass and are proved; the other 20 are infeasible."""
    tables = random_case(7, number).tables if number % 5 < 3 else drawn(7, number).tables
    plan = plan_motion(Problem.from_tables(str(number), tables))
    assert plan.trajectory is not None
    assert plan.with_proof(existence=False).status == plan.status


def test_an_instant_at_which_the_proof_refutes_a_limit_is_a_place_to_refine():
    """Within 0.01 rad the speed is limited; the samples of four intervals miss it, and the motion passes there too fast."""

    def speed_at_the_spot(at):
        return at.velocity_rad_s["J"] * ca.exp(-(((at.position_rad["J"] - 0.7123) / 0.01) ** 2))

    spot = linkplan.ExtraLimit(name="speed at a spot", expression=speed_at_the_spot, upper=2.0, unit="rad/s")
    asked = {"start_deg": {"J": 0.0}, "goal_deg": {"J": 90.0}, "duration_s": 1.0, "mesh": {"intervals": 4}}
    problem = linkplan.Problem.reach(HINGE, **asked, minimize="effort", extra_limits=[spot])
    at_once = plan_motion(problem)
    assert at_once.passed
    refuted = at_once.with_proof(existence=False)
    (over,) = refuted.verdict.overruns
    assert (refuted.status, over.limit, over.name, over.unit) == ("failed", "extra", "speed at a spot", "rad/s")
    assert over.value > over.bound == pytest.approx(2.0, rel=1e-6)
    assert over.time_s == pytest.approx(refuted.proof.of("refuted")[0].time_s)
    plan = linkplan.plan(problem, prove=True)
    assert plan.status == "optimal", plan.message
    assert plan.proof.complete
    assert plan.objective > at_once.objective
