"""Where first motions begin, and which rods they lock: homes outside tendons' ranges or on flat energies, spins of rods."""

import copy
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from linkplan.models.deadline import Deadline
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import failed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say
from linkplan.studies.check.new.changes import changed_mechanism
from linkplan.studies.check.new.first_motion import first_motion
from linkplan.studies.check.new.hanging import at_gravity_equilibrium
from linkplan.studies.check.softness import SOFT_IN_MOTION, home_gap, planned_gap, travel
from tests.support.drawn_by_others import arm

# A rod between ball joints whose rocker is pinned at two points: the coordinate of the rod's spin is an angle of ball_b.
ROD_ON_A_ROCKER = """<mujoco><option gravity="0 0 0"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
<body><joint name="motor" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1" size=".01"/>
<body pos="0 0 .1" quat="0.186517 -0.195973 0.950047 0.155616"><joint name="ball_a" type="ball"/>
<geom type="capsule" fromto="0 0 0 -0.271799 -0.085388 0.106461" size=".01"/>
<body pos="-0.271799 -0.085388 0.106461" quat="0.699995 -0.422934 0.293859 0.494753"><joint name="ball_b" type="ball"/>
<geom type="capsule" fromto="0 0 0 -0.138103 -0.138146 0.042935" size=".01"/>
<site name="p1" pos="-0.139290 -0.122232 0.090320"/><site name="p2" pos="-0.136915 -0.154060 -0.004450"/></body></body>
</body>
<site name="q1" pos=".3 .1 -.1"/><site name="q2" pos=".3 0 -.1"/></worldbody>
<equality><connect site1="p1" site2="q1"/><connect site1="p2" site2="q2"/></equality>
<actuator><motor joint="motor" ctrlrange="-5 5"/></actuator></mujoco>"""


def test_the_rod_that_spins_is_locked_also_where_its_spin_is_another_ball_joint_s_angle():
    free = load_mechanism(ROD_ON_A_ROCKER)
    assert [joint.chart for joint in np.array(free.independent_joints)[~free.actuated]] == ["ball_b"]
    mechanism, notes = changed_mechanism({"model": ROD_ON_A_ROCKER})
    assert mechanism.source["lock_spin"] == ["ball_a"]
    assert (mechanism.dof, mechanism.n_u) == (1, 1)
    assert any("(mechanism.lock_spin: ball_a)" in note for note in notes)


ROPE = """<mujoco><option gravity="0 0 0"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
<site name="wall" pos=".3 0 0"/><body><joint name="A" axis="0 1 0" range="-150 150"/>
<geom type="capsule" fromto="0 0 0 0 0 .2" size=".01" mass="1"/><site name="end" pos="0 0 .2"/></body></worldbody>
<tendon><spatial name="rope" limited="true" range=".4 .6"><site site="wall"/><site site="end"/></spatial></tendon>
<actuator><motor joint="A" ctrlrange="-2 2"/></actuator></mujoco>"""


def test_a_home_outside_a_tendon_s_range_is_left_for_one_that_keeps_it(tmp_path, ask):
    """The rope from (0.3, 0) to 0.2 (sin A, cos A) has the length sqrt(0.13 - 0.12 sin A): from 0.4 m for A = -14.48 deg."""
    (tmp_path / "rope.xml").write_text(ROPE, encoding="utf-8")
    code, out, _ = ask("new", str(tmp_path / "rope.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 0, out
    motion = tomllib.loads((tmp_path / "first.toml").read_text(encoding="utf-8"))["motion"]
    angles = np.radians([motion["start_deg"]["A"], motion["goal_deg"]["A"]])
    lengths = np.sqrt(0.13 - 0.12 * np.sin(angles))
    assert np.all((lengths >= 0.4) & (lengths <= 0.6))
    assert abs(np.degrees(angles[1] - angles[0])) > 10


def test_two_arms_whose_ropes_are_both_outside_their_ranges_begin_where_each_keeps_its_own():
    """The middle of a joint's range, 0 deg, is outside; the ropes are within their ranges from -14.48 deg on."""
    arm, rope = (
        ROPE[ROPE.index("<site name") : ROPE.index("</worldbody>")],
        ROPE[ROPE.index("<spatial") : ROPE.index("</tendon>")],
    )
    motor = '<motor joint="A" ctrlrange="-2 2"/>'
    both = ROPE
    for one in (arm, rope, motor):
        twin = one.replace('"A"', '"B"').replace("wall", "post").replace("end", "tip").replace("rope", "cord")
        both = both.replace(one, one + twin.replace("<body>", '<body pos="0 1 0">').replace(".3 0 0", ".3 1 0"))
    first = first_motion({"model": both}, lambda _: None)
    assert first.planned, first.why
    assert {name: angle < -14.4 for name, angle in first.mechanism.source["home_deg"].items()} == {"A": True, "B": True}


@pytest.mark.slow
def test_a_home_outside_a_servo_s_ctrlrange_is_left_for_the_middle_of_the_range():
    """A stiff servo holds its arm between its ctrls of -72 and -33 deg alone; the arm turns from -180 to 180 deg."""
    servo = """<mujoco><worldbody><body><joint name="A" axis="0 1 0" range="-180 180"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".01" mass="1"/></body></worldbody>
    <actuator><position joint="A" kp="10000" ctrlrange="-1.27 -.58"/></actuator></mujoco>"""
    first = first_motion({"model": servo}, print)
    assert first.planned
    motion = first.tables["motion"]
    angles = [motion["start_deg"]["A"], motion["goal_deg"]["A"]]
    assert -72.8 < min(angles) < max(angles) < -33.2
    assert max(angles) - min(angles) > 10


def test_a_home_on_a_flat_energy_is_left_as_it_is():
    """A cart that nothing drives rests anywhere on its rail; off an upright pendulum the search goes."""
    cart = """<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0" range="-.5 .5"/>
    <geom size=".05" mass="1"/>
    <body><joint name="hip" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 {end}" size=".02" mass="1"/></body></body>
    </worldbody><actuator><motor joint="{driven}" ctrlrange="-20 20"/></actuator></mujoco>"""
    assert at_gravity_equilibrium(load_mechanism(cart.format(end=-0.3, driven="hip"))) is None
    hanging = at_gravity_equilibrium(load_mechanism(cart.format(end=0.3, driven="rail")))
    assert abs(np.degrees(hanging.home[1])) == pytest.approx(180.0)


def test_a_cart_that_nothing_drives_ends_where_its_momentum_takes_it():
    """The centre of mass of cart and leg stays: m l sin(hip) / 2 of 1 kg of 2 kg, back against the leg."""
    cart = """<mujoco><worldbody><body><joint name="rail" type="slide" axis="1 0 0" range="-.5 .5"/>
    <geom size=".05" mass="1"/><body><joint name="hip" axis="0 1 0"/><inertial pos="0 0 -.15" mass="1"
    diaginertia=".01 .01 .01"/></body></body></worldbody>
    <actuator><motor joint="hip" ctrlrange="-20 20"/></actuator></mujoco>"""
    first = first_motion({"model": cart}, lambda _: None)
    assert first.planned
    assert "goal_m" not in first.tables["motion"]
    rail, hip = first.plan.trajectory.position[-1, -1]
    assert abs(hip) > 0.1
    assert rail == pytest.approx(0.15 * np.sin(hip) / 2, rel=1e-5)


# A hopper on a boom that turns about a post; weight drops the boom until the leg's foot meets the ground.
HOPPER = """<mujoco><compiler autolimits="true"/><worldbody><geom type="plane" size="2 2 .1" pos="0 0 {ground}"/>
<body pos="0 0 .5"><joint name="turn" axis="0 0 1" damping=".05"/><geom size=".03" mass=".05"/>
<body><joint name="pitch" axis="0 1 0" {held}/><geom type="capsule" fromto="0 0 0 .6 0 0" size=".02" mass=".1"/>
<body pos=".6 0 0"><joint name="hip" axis="1 0 0" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".1"/>
</body></body></body></worldbody><actuator><motor joint="hip" ctrlrange="-5 5"/></actuator></mujoco>"""


@pytest.mark.parametrize(
    ("held", "ground", "lock"),
    [('range="-10 20"', "-9", {"pitch": 0.0}), ("", "0", {"pitch": 0.0}), ("", "-9", {}), ('stiffness="50"', "-9", {})],
)
def test_what_weight_drops_onto_a_stop_or_the_ground_is_locked(held, ground, lock):
    mechanism, notes = changed_mechanism({"model": HOPPER.format(held=held, ground=ground)})
    assert mechanism.selection.lock == lock
    assert any("undriven joints that would fall" in note for note in notes) == bool(lock)


def test_a_hopper_moves_its_leg_while_its_boom_coasts():
    first = first_motion({"model": HOPPER.format(held='range="-10 20"', ground="-9")}, lambda _: None)
    assert first.planned
    assert set(first.tables["motion"]["goal_deg"]) == {"hip"}
    turned = first.plan.trajectory.position[:, :, 0]
    assert np.ptp(turned) > np.radians(0.1)


# A wrist that its author has fixed by its range, at which it is not drawn.
FIXED = """<mujoco><compiler autolimits="true"/><worldbody><body><joint name="arm" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
<body pos=".3 0 0"><joint name="wrist" axis="0 1 0" range="{range_deg}"/>
<geom type="capsule" fromto="0 0 0 .1 0 0" size=".02"/></body></body></worldbody>
<actuator><motor joint="arm" ctrlrange="-40 40"/><motor joint="wrist" ctrlrange="-9 9"/></actuator></mujoco>"""


@pytest.mark.parametrize(("range_deg", "lock"), [("-8.6288 -8.6286", {"wrist": -8.6287}), ("-8.7 -8.6", {})])
def test_a_joint_that_its_range_fixes_is_locked_there(range_deg, lock):
    mechanism, notes = changed_mechanism({"model": FIXED.format(range_deg=range_deg)})
    assert mechanism.selection.lock == lock
    assert mechanism.dof == 2 - len(lock)
    assert any("joints with ranges of zero width" in note for note in notes) == bool(lock)


# A driven hip carries a leg on a spring. The leg's slider-crank stands at a dead centre, where its motor has no arm.
DEAD_CENTRE = """<mujoco><compiler autolimits="true"/><default><geom contype="0" conaffinity="0"/></default><worldbody>
<body><joint name="hip" axis="1 0 0" range="-40 40"/><geom size=".05" mass="1"/>
<body><joint name="leg" axis="0 1 0" stiffness="500" damping="2"/>
<inertial pos="0 0 -.1" mass="2" diaginertia=".02 .02 .02"/>
<body><joint name="crank" axis="0 1 0" range="-80 80"/><geom type="capsule" fromto="0 0 0 .1 0 0" size=".01" mass=".2"/>
<body pos=".1 0 0"><joint name="pin" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".01" mass=".1"/>
<site name="end" pos=".3 0 0"/></body></body>
<body pos=".4 0 0"><joint name="slider" type="slide" axis="1 0 0"/><geom size=".02" mass=".2"/><site name="eye"/></body>
</body>
</body></worldbody><equality><connect site1="end" site2="eye"/></equality>
<actuator><motor joint="hip" ctrlrange="-90 90"/><motor joint="slider" ctrlrange="-90 90"/></actuator></mujoco>"""


def test_a_motion_begins_off_the_dead_centre_at_which_a_sprung_mechanism_stands():
    first = first_motion({"model": DEAD_CENTRE}, lambda _: None)
    assert first.planned, first.why


def test_the_smooth_path_of_a_large_robot_is_its_first_motion(monkeypatch):
    monkeypatch.setattr("linkplan.planner.search.starts.plan_from", None)
    first = first_motion({"model": arm(6, 6)}, lambda _: None)
    assert first.planned
    assert first.plan.solved is None
    assert first.tables["solver"]["max_time_s"] >= 5


def test_a_smooth_path_that_takes_all_the_time_leaves_none_for_a_search(monkeypatch):
    tried = []

    def late(problem: Problem, _say: Say, methods: tuple = (None,), _diagnoses: tuple = ()) -> Plan:
        tried.append(methods)
        deadline = Deadline().within(problem.solver.max_time_s)
        while not deadline.passed:
            pass
        return Plan(problem=problem, verdict=failed("no motion"))

    for name, value in (("plan_motion", late), ("_TIME_BUDGET_S", 0.1), ("_MIN_SOLVE_S", 0.05)):
        monkeypatch.setattr(f"linkplan.studies.check.new.first_motion.{name}", value)
    assert not first_motion({"model": arm(6, 6)}, lambda _: None).planned
    assert set(tried) == {()}, "no search follows"


# A light driven joint turns a heavy one by a coupling with constant impedance; no weight acts about vertical axes.
LIGHT, HEAVY, IMPEDANCE, TIME_CONSTANT_S = 0.01, 1.0, 0.9, 0.02
COUPLED = f"""
<mujoco><worldbody>
  <body><joint name="motor" axis="0 0 1" range="-90 90"/>
    <inertial pos="0 0 0" mass="1" diaginertia="{LIGHT} {LIGHT} {LIGHT}"/></body>
  <body pos="1 0 0"><joint name="wheel" axis="0 0 1" range="-90 90"/>
    <inertial pos="0 0 0" mass="1" diaginertia="{HEAVY} {HEAVY} {HEAVY}"/></body>
</worldbody>
<equality>
  <joint joint1="wheel" joint2="motor" solref="{TIME_CONSTANT_S} 1" solimp="{IMPEDANCE} {IMPEDANCE} 0.001"/>
</equality>
<actuator><motor joint="motor" ctrlrange="-2000 2000"/></actuator></mujoco>"""


def test_loops_that_a_motion_opens_are_stiff_with_its_plan():
    found = first_motion({"model": COUPLED}, lambda _: None)
    assert found.planned
    assert SOFT_IN_MOTION in found.changes
    assert found.tables["mechanism"]["solref"] == "stiff"
    assert found.plan is not None
    assert planned_gap(found.plan) < 0.01
    stiff = 2 * found.mechanism.model.opt.timestep
    np.testing.assert_allclose(found.mechanism.model.eq_solref[:, 0], stiff)


def test_the_gap_along_a_plan_is_that_of_the_coupling_s_effort():
    """Of one row: r = R f / (K d), with f = I_2 a, R = (1/I_1 + 1/I_2) (1 - d) / d and K = 1 / (d tau)^2."""
    found = first_motion({"model": COUPLED, "solref": "stiff"}, lambda _: None)
    assert found.plan is not None
    problem, trajectory = found.plan.problem, found.plan.trajectory
    model = copy.copy(problem.mechanism.model)
    model.eq_solref[:], model.eq_solimp[:, :3] = (TIME_CONSTANT_S, 1.0), (IMPEDANCE, IMPEDANCE, 0.001)
    softer = problem.varied(mechanism=replace(problem.mechanism, model=model))
    assert home_gap(softer.mechanism) == 0.0
    times = 0.5 * (trajectory.breaks_s[1:] + trajectory.breaks_s[:-1])
    a = float(np.abs(trajectory.acceleration_at(times)).max())
    R = (1 / LIGHT + 1 / HEAVY) * (1 - IMPEDANCE) / IMPEDANCE
    expected = R * HEAVY * a * (IMPEDANCE * TIME_CONSTANT_S) ** 2 / IMPEDANCE
    assert expected > 0.01
    assert planned_gap(replace(found.plan, problem=softer)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("range_deg", "time_constant_s", "stiff"), [(3, 0.01, True), (90, 0.004, False)])
def test_a_gap_is_small_beside_what_the_joints_travel(range_deg, time_constant_s, stiff):
    other = COUPLED.replace(f'"{TIME_CONSTANT_S} 1"', f'"{time_constant_s} 1"')
    model = other.replace("-90 90", f"-{range_deg} {range_deg}")
    found = first_motion({"model": model}, lambda _: None)
    assert found.planned
    assert (SOFT_IN_MOTION in found.changes) == stiff
    assert found.plan is not None
    start, goal = found.plan.problem.motion.start, found.plan.problem.motion.goal
    assert travel(found.plan) == pytest.approx(abs(goal[0] - start[0]), rel=1e-9)
    assert planned_gap(found.plan) < 0.01 * travel(found.plan)
