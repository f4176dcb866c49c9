"""Claims of every kind: enclosures against mpmath in 50 digits, and limits of all kinds beside what a motion needs."""

from dataclasses import replace

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from flint import arb, ctx

import linkplan
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.proof.branch import newton
from linkplan.planner.proof.claims import Claim, claims_of, reference_claims
from linkplan.planner.proof.motion import Piece, State
from linkplan.planner.proof.prove import TAYLOR_ORDER, prove, states_of
from linkplan.planner.proof.taylor import TaylorForm
from linkplan.planner.proof.walk import blocks_of
from linkplan.planner.search.planning import plan_motion
from linkplan.planner.trajectory import Trajectory
from tests.support.arms import LOWER, UPPER, foot_of
from tests.support.four_bars import random_bars
from tests.support.linkages import loaded
from tests.support.mechanisms import doubled_pin, random_quaternion, replaced
from tests.support.motions import motion_along
from tests.support.mp_functions import ball, mp_motion, mp_pose, mp_values
from tests.support.plans import optimal, problem_of
from tests.support.random_motions import motion_of, needed
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem
from tests.support.spoilt import answers_beside_limits

CENTRE, RADIUS, INTERVAL = 0.5, 0.25, 1
# Of the gripper's servo in tests/support/linkages.py.
KP, KV = 5.0, 0.05


def check(problem, motion: Trajectory, words: str, exact, shares=(-1.0, -0.37, 0.0, 0.62, 1.0)) -> None:
    """Check that a claim's enclosure on a box contains `exact`(q, rates, u, time) in 50 digits at shares of the box."""
    mechanism, piece = problem.mechanism, Piece.of(motion, INTERVAL)
    blocks = blocks_of(mechanism)
    s = np.array([float(p(arb(CENTRE)).mid()) for p in piece.position])
    guess = newton(blocks, s, motion.start_pose[list(blocks.dependent)])
    slack = [arb(0)] * motion.n_s
    middle, whole, _ = states_of(blocks, piece, (CENTRE, RADIUS), guess, slack, TAYLOR_ORDER)
    (claim,) = [claim for claim in claims_of(problem, motion)[0] if words in claim.name]
    ctx.cap = TAYLOR_ORDER + 2
    first = claim.values(middle)
    ctx.cap = TAYLOR_ORDER + 3
    forms = [TaylorForm.of(a, b, TAYLOR_ORDER) for a, b in zip(first, claim.values(whole), strict=True)]
    for share in shares:
        tau, x = mp.mpf(CENTRE) + mp.mpf(RADIUS) * mp.mpf(share), arb(share)
        positions, v, _ = mp_motion(motion, INTERVAL, tau)
        near = np.empty(mechanism.n_q)
        near[list(blocks.independent)], near[list(blocks.dependent)] = [float(p) for p in positions], guess
        q = mp_pose(mechanism, positions, near)
        columns = mp.matrix(mechanism.dof, mechanism.n_q)
        for k, entry in enumerate(mp_values(mechanism.dynamics.velocity_map, q)):
            columns[k // mechanism.n_q, k % mechanism.n_q] = entry
        rates = [sum(columns[k, i] * v[k] for k in range(mechanism.dof)) for i in range(mechanism.n_q)]
        degree = len(motion.effort) - 1
        u = [
            sum(mp.binomial(degree, k) * tau**k * (1 - tau) ** (degree - k) * mp.mpf(c) for k, c in enumerate(column))
            for column in motion.effort[:, INTERVAL].T.tolist()
        ]
        begin, end = (mp.mpf(float(t)) for t in motion.breaks_s[INTERVAL : INTERVAL + 2])
        values = exact(q, rates, u, begin + tau * (end - begin))
        for form, value in zip(forms, values, strict=True):
            found = sum((c * x**k for k, c in enumerate(form.coefficients)), arb(0)) + arb(0, form.remainder)
            assert found.contains(ball(value)), (words, share, found, value)
            assert form.whole.contains(ball(value))
            assert not form.whole.contains(ball(value + 10)), "and says something"


def gripper():
    return motion_of(loaded("gripper"), np.random.default_rng(0), size=0.1)


def test_the_ctrl_of_a_position_servo_is_enclosed():
    problem, motion = gripper()
    names = [joint.name for joint in problem.mechanism.joints]
    right, left = (names.index(name) for name in ("crank_r", "crank_l"))
    grip = [actuator.name for actuator in problem.mechanism.actuators].index("grip")

    def ctrl(q, rates, u, _):
        length, speed = (mp.mpf(0.5) * (x[right] - x[left]) for x in (q, rates))
        return [(u[grip] + mp.mpf(KP) * length + mp.mpf(KV) * speed) / mp.mpf(KP)]

    check(problem, motion, "ctrl of grip", ctrl)


def test_a_users_expression_is_enclosed():
    problem, motion = gripper()
    names = [joint.name for joint in problem.mechanism.joints]
    finger, lift = names.index("finger_r"), names.index("lift")
    limit = linkplan.ExtraLimit(
        name="mine",
        expression=lambda at: at.velocity_rad_s["finger_r"] * at.position_rad["lift"] + at.effort["grip"] ** 2,
        upper=1.0,
    )
    grip = [actuator.name for actuator in problem.mechanism.actuators].index("grip")
    limited = problem.varied(extra_limits=(limit,))
    check(limited, motion, "extra limit 'mine'", lambda q, rates, u, _: [rates[finger] * q[lift] + u[grip] ** 2])


@pytest.mark.parametrize("bend", [0.0, 0.02])
def test_the_distance_from_a_tube_is_enclosed_beside_its_corner_too(bend):
    problem, motion = gripper()
    mechanism = problem.mechanism
    names = [mechanism.model.site(k).name for k in range(mechanism.model.nsite)]
    site = names.index("pin_r")
    places = mechanism.dynamics.site_places
    times = motion.breaks_s[INTERVAL] + np.diff(motion.breaks_s)[INTERVAL] * np.array([0.0, CENTRE, 1.0])
    a, b, c = (np.array(places(q))[:, site] for q in follow(mechanism, motion.position_at(times), motion.start_pose))
    along = np.stack([a, b, c]) + np.array([[0, 0, 0.01], [bend, 0, 0.012], [0, 0, 0.02]])
    limit = SiteLimit(site="pin_r", index=site, what="tube", name="pin_r", low=0.0, high=0.05, along=along)

    def squared(q, *_):
        p = mp_values(places, q)[3 * site : 3 * site + 3]
        found = []
        for first, last in zip(along.tolist(), along[1:].tolist(), strict=False):
            way = [mp.mpf(y) - mp.mpf(x) for x, y in zip(first, last, strict=True)]
            off = [x - mp.mpf(y) for x, y in zip(p, first, strict=True)]
            share = sum(x * y for x, y in zip(way, off, strict=True)) / sum(x * x for x in way)
            share = min(max(share, mp.mpf(0)), mp.mpf(1))
            found.append(sum((x - share * y) ** 2 for x, y in zip(off, way, strict=True)))
        return [min(found)]

    check(problem.varied(limits=replace(problem.limits, site=(limit,))), motion, "from the tube", squared)


@pytest.mark.slow
def test_the_distance_from_a_sine_is_enclosed_and_proved():
    plan = optimal("knee-sine")
    reference = plan.problem.reference

    def off(q, _rates, _u, time):
        turned = 2 * mp.pi * mp.mpf(reference.frequency_hz) * time + mp.mpf(float(reference.phase[0]))
        sine = mp.mpf(float(reference.amplitude[0])) * mp.sin(turned)
        return [q[int(plan.problem.mechanism.independent[0])] - mp.mpf(float(reference.bias[0])) - sine]

    check(plan.problem, plan.trajectory, "from its reference", off)
    moved = replace(plan.trajectory, position=plan.trajectory.position + 1e-5)
    for motion, answer in ((plan.trajectory, "proved"), (moved, "refuted")):
        found = [f.answer for f in prove(plan.problem, motion, existence=False).findings if "from its reference" in f.name]
        assert found == [answer]


def pin_held_twice(text: str = "") -> Mechanism:
    return load_mechanism(text or doubled_pin(random_bars()[0], random_quaternion(np.random.default_rng(0))))


def test_rows_that_the_branch_does_not_solve_are_proved():
    problem, motion = motion_of(pin_held_twice(), np.random.default_rng(1), size=0.1)
    (found,) = [f for f in prove(problem, motion, existence=False).findings if "redundant" in f.name]
    assert found.answer == "proved"
    assert abs(found.bound) < 1e-10


@pytest.mark.parametrize(("closed_m", "answer"), [(1e-9, "refuted"), (2e-7, "proved")])
def test_rows_that_do_not_hold_although_the_others_do_are_refuted_unless_the_file_is_rounded_so(closed_m, answer):
    """The second pin is moved by 1e-7 m after its rows were counted: the first pin's loop still closes."""
    text = doubled_pin(random_bars()[0], random_quaternion(np.random.default_rng(0)))
    problem, motion = motion_of(pin_held_twice(text), np.random.default_rng(1), size=0.1)
    mechanism = problem.mechanism
    q = ca.SX.sym("q", mechanism.n_q)
    phi = mechanism.dynamics.closure(q)
    away = np.zeros(phi.numel())
    away[[row for row in range(phi.numel()) if row not in mechanism.closure_rows][-1]] = 1e-7
    dynamics = replace(mechanism.dynamics, closure=ca.Function("closure", [q], [phi + ca.DM(away)]))
    broken = problem.varied(mechanism=replace(mechanism, dynamics=dynamics, closed_m=closed_m))
    (found,) = [f for f in prove(broken, motion, existence=False).findings if "redundant" in f.name]
    assert found.answer == answer


def test_an_overrun_of_the_smaller_end_of_a_limit_is_refuted():
    problem, motion = gripper()
    least = float(motion.effort_at(motion.dense_times(30000))[:, 0].min())
    for low, answer in ((least - 1e-9 * abs(least), "proved"), (least + 1e-6 * abs(least), "refuted")):
        effort = np.array(problem.limits.effort)
        effort[0] = low, 1e4 * abs(least)
        limited = problem.varied(limits=replace(problem.limits, effort=effort))
        found = {f.answer for f in prove(limited, motion, existence=False).findings if "planned effort of lift" in f.name}
        assert found == {answer}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gripper", "press", "leg"])
def test_limits_of_all_kinds_are_proved_below_and_refuted_beyond(name):
    """`make bench` (part proofs) does so for nineteen families of mechanisms."""
    rng = np.random.default_rng(0)
    found = answers_beside_limits(loaded(name), rng)
    assert len(found) >= 14
    assert all(answer.right for answer in found), [answer for answer in found if not answer.right]


def test_the_text_of_a_model_without_a_second_pin_has_no_redundant_claim():
    mechanism = load_mechanism(replaced(random_bars()[0].mjcf(np.random.default_rng(0)), "four-bar", "plain"))
    problem, motion = motion_of(mechanism, np.random.default_rng(0), size=0.1)
    assert not [f for f in prove(problem, motion, existence=False).findings if "redundant" in f.name]


# Both motors turn the first joint of two; nothing drives the second.
TWO_ON_ONE = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" axis="0 1 0"/>
<inertial mass="1" pos=".2 0 0" diaginertia=".01 .01 .01"/><body pos=".3 0 0"><joint name="b" axis="0 1 0"/>
<inertial mass="1" pos=".1 0 0" diaginertia=".01 .01 .01"/></body></body></worldbody>
<actuator><motor name="one" joint="a" ctrlrange="-50 50"/><motor name="two" joint="a" gear="2" ctrlrange="-50 50"/>
</actuator></mujoco>"""


def test_efforts_of_two_motors_on_one_joint_of_two_are_decided():
    problem, motion = motion_of(load_mechanism(TWO_ON_ONE), np.random.default_rng(2))
    largest = np.abs(needed(problem, motion, motion.dense_times(100))).max()
    limited = problem.varied(limits=replace(problem.limits, effort=np.full((2, 2), 1.05 * largest) * [-1, 1]))
    found = [f for f in prove(limited, motion, existence=False).findings if "by inverse dynamics" in f.name]
    assert [f.answer for f in found] == ["proved", "proved"]
    assert largest <= max(abs(f.bound) for f in found) <= 1.02 * largest


def test_a_site_away_from_its_goal_is_refuted():
    arm = arm_of(UPPER, LOWER)
    problem = site_problem(arm, {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}, "duration_s": 1.0})
    plan = plan_motion(problem)
    for moved, answer in ((0.0, "proved"), (1e-5, "refuted")):
        position = np.array(plan.trajectory.position)
        position[-1, -1, 0] += moved
        proof = prove(problem, replace(plan.trajectory, position=position), existence=False)
        assert [f.answer for f in proof.findings if "sites are where" in f.name] == [answer]


def test_a_motion_without_effort_is_allowed_a_millionth_of_the_effort_of_its_inertia():
    """The certificate allows the same: rounding of that effort is no effort that the plan lacks."""
    problem, motion = motion_of(load_mechanism("five-bar"), np.random.default_rng(3))
    still = replace(motion, effort=np.zeros_like(motion.effort))
    marks = {claim.marks for claim in claims_of(problem, still)[0] if "that the planned effort lacks" in claim.name}
    time = motion.dense_times(50)
    poses = follow(problem.mechanism, motion.position_at(time), motion.start_pose)
    inertias = (np.array(problem.mechanism.dynamics.reduced_inertia(q)) for q in poses)
    allowed = 1e-6 * max(np.abs(M @ a).max() for M, a in zip(inertias, motion.acceleration_at(time), strict=True))
    assert sorted(marks) == [(pytest.approx(-allowed, rel=0.05), pytest.approx(allowed, rel=0.05))]  # of coarser samples


def test_the_distance_from_a_reference_is_that_of_its_sine():
    """bias + amplitude sin(2 pi f t + phase), in the joint's own angle."""
    asked = "reference.frequency_hz=1.5", "reference.phase_deg.O=25.0", "reference.bias_deg.O=-4.0"
    problem = problem_of("knee-sine", *asked)
    motion = motion_along([0.0, 2 / 3], [[[-1.0]], [[1.0]]], start_pose=problem.mechanism.home, periodic=True)
    (claim,) = reference_claims(problem, motion)
    reference, time, angle = problem.reference, 0.37, 0.2
    exact = angle - (reference.bias[0] + reference.amplitude[0] * np.sin(2 * np.pi * 1.5 * time + np.radians(25.0)))
    still = dict.fromkeys(("z", "v", "u"), ()) | {"rate": arb(1), "blocks": None, "piece": None}
    (value,) = claim.values(State(s=[arb(angle)], time=arb(time), **still))
    assert float(value.mid()) == pytest.approx(exact, rel=1e-12)
    assert claim.marks == pytest.approx((-2e-6, 2e-6)), "a millionth of the motion's span"
    assert (reference.bias[0], reference.phase[0]) == pytest.approx(np.radians([-4.0, 25.0]))


def test_a_servo_whose_length_only_mujoco_knows_is_undecided():
    problem, motion = gripper()
    actuators = tuple(replace(one, has_length=False) for one in problem.mechanism.actuators)
    unknown = problem.varied(mechanism=replace(problem.mechanism, actuators=actuators))
    assert [one.reason for one in claims_of(unknown, motion)[1] if one.name == "ctrl of grip"] == [
        "not proved: the model has no expression for its length"
    ]
    assert not [one for one in claims_of(problem, motion)[1] if one.name == "ctrl of grip"]


POSE = np.array([0.7, -1.1])
NORMAL, THROUGH = np.array([3.0, 0.0, 4.0]) / 5.0, np.array([0.9, 5.0, 0.2])


def site_claim(problem: Problem) -> Claim:
    """Return the claim on the only limit on a site."""
    _, still = motion_of(problem.mechanism, np.random.default_rng(0))
    (claim,) = [claim for claim in claims_of(problem, still)[0] if "of site foot" in claim.name]
    return claim


@pytest.mark.parametrize(
    ("limit", "quantity"),
    [
        ({"normal": (5 * NORMAL).tolist(), "at": THROUGH.tolist()}, lambda foot: NORMAL @ (foot - THROUGH)),
        ({"z": [-0.5, 0.5]}, lambda foot: foot[2]),
    ],
    ids=["wall", "box"],
)
def test_a_claim_encloses_the_place_of_a_site(limit, quantity):
    problem = site_problem(arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}}, {"foot": limit})
    still = dict.fromkeys(("z", "v", "u"), ()) | {"rate": arb(1), "time": arb(0), "piece": None}
    at = State(blocks=blocks_of(problem.mechanism), s=[arb(x) for x in POSE], **still)
    (value,) = site_claim(problem).values(at)
    expected = quantity(foot_of(POSE)[0])
    assert abs(float(value.mid()) - expected) < 1e-12
    assert float(value.rad()) < 1e-12


@pytest.mark.parametrize("radius_m", [0.05, 3.0])
def test_a_tube_is_kept_within_its_radius_and_the_rounding_that_a_certificate_allows(radius_m):
    problem = site_problem(arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}})
    index = problem.mechanism.model.site("foot").id
    along = np.array([ABOVE, BELOW])
    tube = SiteLimit(site="foot", index=index, what="tube", name="foot", low=0.0, high=radius_m, along=along)
    claim = site_claim(problem.varied(limits=replace(problem.limits, site=(tube,))))
    assert claim.marks[1] == pytest.approx((radius_m + 1e-9 * max(1.0, radius_m)) ** 2, rel=1e-15)
    assert claim.marks[1] > radius_m**2
