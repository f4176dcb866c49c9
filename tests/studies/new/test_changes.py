"""What `new` changes of a model that has no first motion as it is, and says."""

import tomllib

import numpy as np
import pytest

from linkplan.models.errors import ModelError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.planner.problem.problem import Problem
from linkplan.studies.check.new.changes import changed_mechanism, raised_limits
from linkplan.studies.check.new.hanging import hanging_columns
from tests.support.data import DATA
from tests.support.parallel_ankle import ankle_text, soft_ankle

# A chassis that slides and pitches in a plane, with a wheel-leg of five bars whose motors are on the chassis.
WHEEL_LEG = """<mujoco><option timestep="0.001"/><compiler angle="degree" autolimits="true"/>
  <default><joint axis="0 1 0" damping="0.02" armature="0.001"/>
    <geom contype="0" conaffinity="0" size="0.01" mass="0.2"/></default>
  <worldbody><body name="chassis" pos="0 0 0.5"><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/><joint name="pitch"/><geom type="box" size="0.1 0.1 0.05" mass="5"/>
    <body name="front" pos="0.05 0 0" euler="0 30 0"><joint name="front_hip"/><geom type="capsule" fromto="0 0 0 0.15 0 0"/>
      <body name="front_shin" pos="0.15 0 0" euler="0 100 0"><joint name="front_knee"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0"/><site name="foot" pos="0.25 0 0"/>
        <body name="wheel" pos="0.25 0 0"><joint name="axle"/><geom type="cylinder" size="0.05 0.02" euler="90 0 0"/></body>
      </body></body>
    <body name="rear" pos="-0.05 0 0" euler="0 150 0"><joint name="rear_hip"/><geom type="capsule" fromto="0 0 0 0.15 0 0"/>
      <body name="rear_shin" pos="0.15 0 0" euler="0 -100 0"><joint name="rear_knee"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0"/><site name="tip" pos="0.25 0 0"/></body></body>
  </body></worldbody>
  <equality><connect name="pin" site1="foot" site2="tip"/></equality>
  <actuator><motor name="front_drive" joint="front_hip" ctrlrange="-20 20"/>
    <motor name="rear_drive" joint="rear_hip" ctrlrange="-20 20"/><motor name="wheel_drive" joint="axle"/></actuator>
  </mujoco>"""
ARM = """<mujoco><worldbody><body><joint name="arm" axis="0 1 0"/>
  <inertial pos="0.5 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <actuator><motor name="drive" joint="arm" ctrlrange="-{effort} {effort}"/></actuator></mujoco>"""
WEIGHT_N_M = 2 * 9.81 * 0.5  # of the arm, at home


@pytest.mark.slow
def test_a_whole_robot_is_planned_on_its_fixed_base(tmp_path, ask):
    (tmp_path / "robot.xml").write_text(WHEEL_LEG, encoding="utf-8")
    target = tmp_path / "first.toml"
    code, out, _ = ask("new", str(tmp_path / "robot.xml"), "-o", str(target))
    assert code == 0, out
    assert "the base chassis floats" in out
    text = target.read_text(encoding="utf-8")
    assert tomllib.loads(text)["mechanism"]["fix_base"] is True
    assert "# CHANGED: the base chassis floats" in text


def test_a_base_that_floats_is_fixed_and_named():
    mechanism, notes = changed_mechanism({"model": WHEEL_LEG})
    assert [joint.name for joint in mechanism.joints] == ["front_hip", "front_knee", "axle", "rear_hip", "rear_knee"]
    assert mechanism.dof == 3
    assert "joints x, z, pitch" in notes[0]


def test_a_loose_ball_is_fixed_and_the_ground_stays():
    ball = '<geom name="floor" type="plane" size="1 1 1"/><body name="ball"><freejoint/><geom size="0.1" mass="1"/></body>'
    mechanism, notes = changed_mechanism({"model": ARM.format(effort=30.0).replace("<worldbody>", f"<worldbody>{ball}")})
    assert [joint.name for joint in mechanism.joints] == ["arm"]
    assert "ball is loose" in notes[0]
    assert "floor" in [mechanism.model.geom(g).name for g in range(mechanism.model.ngeom)]


def test_a_scene_with_many_loose_bodies_is_refused_with_the_remedy_that_a_first_motion_takes():
    balls = (
        '<replicate count="21" offset="0.3 0 0"><body name="ball"><freejoint/><geom size="0.1" mass="1"/></body></replicate>'
    )
    scene = ARM.format(effort=30.0).replace("<worldbody>", f"<worldbody>{balls}")
    with pytest.raises(ModelError, match=r"ball00, .* and 17 more are loose.*mechanism\.fix_base = true"):
        load_mechanism(scene)
    mechanism, notes = changed_mechanism({"model": scene})
    assert mechanism.dof == 1
    assert "and 17 more are loose" in notes[0]
    load_mechanism(scene.replace('count="21"', 'count="20"'))


def test_what_hangs_on_unusable_tendons_alone_is_not_fixed_to_move_nothing(tmp_path, ask):
    held = """<mujoco><worldbody><site name="hook" pos="0 0 1"/><body name="bone"><freejoint name="free"/>
      <geom name="ball" size="0.1" mass="1"/><site name="eye" pos="0 0 0.05"/><site name="far" pos="0 0 -0.3"/></body>
      </worldbody><tendon><spatial name="cord"><site site="hook"/><geom geom="ball" sidesite="eye"/><site site="far"/>
      </spatial></tendon><actuator><motor name="pull" tendon="cord" ctrlrange="-9 0"/></actuator></mujoco>"""
    (tmp_path / "held.xml").write_text(held, encoding="utf-8")
    _, out, _ = ask("check", str(tmp_path / "held.xml"))
    assert "actuator pull on tendon cord" in out
    assert "drive = []" not in out
    assert "linkplan new" not in out
    code, _, err = ask("new", str(tmp_path / "held.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 2
    assert "its tendon passes through the inside of a geom" in err


def test_fingers_on_their_stops_are_locked_there_and_keep_other_locks():
    mechanism, notes = changed_mechanism({"model": str(DATA / "adaptive_gripper.xml"), "lock": {"left_coupler_joint": 0.0}})
    assert mechanism.source["lock"] == {"left_coupler_joint": 0.0, "right_coupler_joint": 0.0}
    assert mechanism.dof == 1
    assert "mechanism.lock: right_coupler_joint = 0" in notes[0]


def test_a_drive_that_cannot_hold_its_weight_gets_twice_what_holds_it(tmp_path, ask):
    weak, _ = changed_mechanism({"model": ARM.format(effort=1.0)})
    raised = raised_limits(weak)
    np.testing.assert_allclose(raised["drive"], [-2 * WEIGHT_N_M, 2 * WEIGHT_N_M], rtol=0.01)
    ends = {"start_deg": {"arm": 0.0}, "goal_deg": {"arm": 1.0}}
    problem = Problem.reach(ARM.format(effort=1.0), **ends, duration_s=1.0, limits={"effort": raised})
    still = np.zeros((1, 1))
    hold = needed_effort(problem.mechanism, problem.mechanism.home[None], still, still)[0]
    assert np.all(hold > problem.limits.effort[:, 0])
    assert np.all(hold < problem.limits.effort[:, 1])
    (tmp_path / "arm.xml").write_text(ARM.format(effort=1.0), encoding="utf-8")
    code, _, err = ask("new", str(tmp_path / "arm.xml"))
    assert code == 0
    assert "too weak to hold the weight at home: limits.effort takes drive" in err


def test_a_limit_that_stands_for_none_is_raised_as_far_as_the_weight_asks():
    placeholder, _ = changed_mechanism({"model": ARM.format(effort=1e-5 * WEIGHT_N_M)})
    np.testing.assert_allclose(raised_limits(placeholder)["drive"], [-2 * WEIGHT_N_M, 2 * WEIGHT_N_M], rtol=0.01)


def test_drives_with_the_same_limit_are_raised_together():
    two = (
        ARM.format(effort=1.0)
        .replace("</body></worldbody>", "</body>{other}</worldbody>")
        .replace("<actuator>", "<actuator>{motor}")
    )
    other = '<body><joint name="wheel" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body>'
    mechanism, _ = changed_mechanism(
        {"model": two.format(other=other, motor='<motor name="spin" joint="wheel" ctrlrange="-1 1"/>')}
    )
    raised = raised_limits(mechanism)
    assert raised["spin"] == raised["drive"]


def test_the_spin_of_a_push_rod_is_locked_and_nothing_else():
    loose = ankle_text().replace(
        '<joint name="rod_roll_left"', '<joint name="rod_spin_left" axis="0 0 1"/><joint name="rod_roll_left"'
    )
    before, _ = changed_mechanism({"model": ankle_text()})
    mechanism, notes = changed_mechanism({"model": loose})
    assert before.dof == mechanism.dof == 2
    (locked,) = mechanism.selection.lock
    assert locked.startswith("rod_")
    assert "one hinge of each is locked" in notes[0]


def test_a_rod_that_swings_about_its_own_line_is_locked_too():
    """The rod's centre of mass lies 2 cm beside its line: a pendulum that nothing drives, in a loop."""
    swinging = ankle_text().replace(
        '<joint name="rod_roll_left"', '<joint name="rod_spin_left" axis="0 0 1"/><joint name="rod_roll_left"'
    )
    middle = swinging[swinging.index('<inertial mass="0.08" pos="') :].split('"')[3]
    bent = " ".join(str(float(x) + offset) for x, offset in zip(middle.split(), (0.0, 0.02, 0.0), strict=True))
    bent_rod = {"model": swinging.replace(f'mass="0.08" pos="{middle}"', f'mass="0.08" pos="{bent}"', 1)}
    as_it_is = load_mechanism(bent_rod["model"])
    assert (as_it_is.dof, len(hanging_columns(as_it_is))) == (3, 1), "it is no spin without a weight"
    mechanism, notes = changed_mechanism(bent_rod)
    assert mechanism.dof == 2
    assert "rods or wheels can spin freely" in notes[0]


def test_a_pendulum_that_hangs_on_a_driven_cart_is_not_locked():
    mechanism, notes = changed_mechanism({"model": "cart-pole"})
    assert (mechanism.dof, notes) == (2, ())


def test_loops_that_let_go_of_the_weight_are_made_stiff():
    mechanism, notes = changed_mechanism({"model": soft_ankle(1e-6)})
    assert mechanism.source["solref"] == "stiff"
    assert "more than 1 % of its size, or 0.01 rad, under its weight" in notes[-1]
    kept, notes = changed_mechanism({"model": soft_ankle(0.08)})
    assert "solref" not in kept.source, notes


def test_a_drive_that_holds_its_weight_keeps_its_limit():
    strong, notes = changed_mechanism({"model": ARM.format(effort=1.1 * WEIGHT_N_M)})
    assert raised_limits(strong) == {}
    assert notes == ()


def test_links_that_overlap_at_home_pass_through_each_other_but_not_through_the_ground():
    overlapping = (
        '<mujoco><worldbody><geom type="box" size="1 1 0.1" pos="0 0 -0.1"/>{one}{other}</worldbody>'
        '<actuator><motor name="drive" joint="one"/></actuator></mujoco>'
    )
    bodies = {
        name: f'<body name="{name}" pos="{x} 0 0"><joint name="{name}" axis="0 1 0"/>'
        '<geom size="0.1" pos="0 0 0.09"/></body>'
        for name, x in (("one", 0.0), ("other", 0.15))
    }
    text = overlapping.format(**bodies)
    mechanism, notes = changed_mechanism({"model": text, "exclude_contacts": []})
    assert mechanism.source["exclude_contacts"] == [["one", "other"]]
    assert mechanism.model.nexclude == 1
    (note,) = notes
    assert "one and other are excluded" in note
    apart, notes = changed_mechanism({"model": text.replace('pos="0.15 0 0"', 'pos="0.25 0 0"')})
    assert (apart.model.nexclude, notes) == (0, ())
    # A base link that is fixed to the world, as a URDF's, is a link, and MuJoCo has the world's children collide with it.
    base = text.replace('size="1 1 0.1" pos="0 0 -0.1"', 'size="0.05 0.05 0.1" pos="0 0 -0.1"')
    assert changed_mechanism({"model": base})[0].source["exclude_contacts"] == [["world", "one"], ["one", "other"]]


def arms(count: int, friction: float) -> str:
    """Return arms on the world, each with a motor and dry friction [N.m]."""
    bodies = "".join(
        f'<body pos="{k} 0 0"><joint name="arm{k}" axis="0 1 0" frictionloss="{friction}"/><geom size="0.1"/></body>'
        for k in range(count)
    )
    motors = "".join(f'<motor joint="arm{k}" ctrlrange="-9 9"/>' for k in range(count))
    return f"<mujoco><worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>"


def test_dry_friction_of_a_large_mechanism_sets_in_over_more_speeds_and_says_so():
    mechanism, notes = changed_mechanism({"model": arms(7, 0.1)})
    assert mechanism.source["friction_transition_deg_s"] == pytest.approx(np.degrees(mechanism.friction_transition))
    assert mechanism.friction_transition > 2 * load_mechanism(arms(7, 0.1)).friction_transition
    assert any("mechanism.friction_transition_deg_s" in note for note in notes)


CAMERA = """<mujoco><worldbody><body><joint name="pan" axis="0 0 1"/><geom size="0.1"/>
  <body pos="0 0 0.2"><joint name="tilt" axis="0 1 0" frictionloss="{friction}"/>
    <geom size="0.02" mass="0.1" pos="{arm} 0 0"/></body></body></worldbody>
  <actuator><motor name="pan" joint="pan" ctrlrange="-9 9"/></actuator></mujoco>"""


@pytest.mark.parametrize(("friction", "arm", "held"), [(0.07, 0.03, True), (0.05, 0.03, False), (0.01, 0.0, True)])
def test_undriven_joints_are_locked_that_dry_friction_holds_at_any_position(friction, arm, held):
    """The weight of 0.1 kg on an arm of 30 mm needs 0.029 N.m at the most; on the axis it needs none."""
    mechanism, notes = changed_mechanism({"model": CAMERA.format(friction=friction, arm=arm)})
    assert (mechanism.dof, mechanism.source.get("lock")) == ((1, {"tilt": 0.0}) if held else (2, None))
    assert any("undriven joints that dry friction holds" in note for note in notes) == held


def test_cylinders_act_without_their_filters():
    ram = ARM.replace("<motor", '<cylinder area="0.1"').format(effort=300.0)
    mechanism, notes = changed_mechanism({"model": ram})
    assert (mechanism.n_u, mechanism.model.na, mechanism.source["drive"]) == (1, 0, ["arm"])
    assert "because plans do not model their states: drive (mechanism.drive: arm)" in notes[0]


def test_what_a_coupling_moves_with_a_locked_joint_is_locked_with_it():
    coupled = (
        CAMERA.format(friction=0.07, arm=0.03)
        .replace(
            "</body></body>", '<body><joint name="lens" axis="0 1 0"/><geom size="0.001" contype="0"/></body></body></body>'
        )
        .replace("<actuator>", '<equality><joint joint1="lens" joint2="tilt" polycoef="0 2 0 0 0"/></equality><actuator>')
    )
    mechanism, _ = changed_mechanism({"model": coupled})
    assert (mechanism.dof, mechanism.source["lock"]) == (1, {"tilt": 0.0, "lens": 0.0})


@pytest.mark.parametrize(
    "table", [{"model": arms(7, 0.0)}, {"model": arms(2, 0.1)}, {"model": arms(7, 0.1), "friction_transition_deg_s": 3.0}]
)
def test_other_dry_friction_stays_as_it_is(table):
    mechanism, notes = changed_mechanism(table)
    assert notes == ()
    assert np.degrees(mechanism.friction_transition) == pytest.approx(table.get("friction_transition_deg_s", 2.0))


FLAT = """<mujoco><option gravity="0 0 0"/><default><joint axis="0 1 0"/><geom type="capsule" size="0.01" contype="0"
  conaffinity="0"/></default><worldbody>{before}<body><joint name="O"/><geom fromto="0 0 0 0.1 0 0"/>
  <body name="coupler" pos="0.1 0 0">
  <joint name="A"/><geom fromto="0 0 0 0.3 0 0"/></body></body><body name="rocker" pos="0.3 0 0"><joint name="C"/>
  <geom fromto="0 0 0 0.1 0 0"/></body>{after}</worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0.3 0 0"/></equality>
  <actuator><motor name="drive" joint="O" ctrlrange="-5 5"/></actuator></mujoco>"""


def test_another_home_than_a_singular_pose_is_named():
    mechanism, notes = changed_mechanism({"model": FLAT.format(before="", after="")})
    assert "home_deg" in mechanism.source
    assert "open or singular at the model's own pose" in notes[0]
    assert "mechanism.home_deg" in notes[0]


def test_a_ball_joint_that_a_default_limits_to_0_deg_is_named(tmp_path, ask):
    rod = """<mujoco><default><joint limited="true"/></default><worldbody><body>
      <joint name="arm" axis="0 1 0" range="-90 90"/>
      <geom size="0.05" fromto="0 0 0 0.3 0 0" type="capsule"/><body pos="0.3 0 0"><joint name="socket" type="ball"/>
      <geom size="0.05" pos="0 0 -0.1"/></body></body></worldbody>
      <actuator><motor name="drive" joint="arm"/></actuator></mujoco>"""
    (tmp_path / "rod.xml").write_text(rod, encoding="utf-8")
    code, out, _ = ask("check", str(tmp_path / "rod.xml"))
    assert code == 1
    assert "PROBLEM: ball joint socket cannot turn" in out
    code, _, err = ask("new", str(tmp_path / "rod.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 2
    assert "ball joint socket cannot turn" in err


def test_forces_that_are_not_honoured_are_no_shut_way_but_left_out_and_named(tmp_path, ask):
    clamped = ARM.format(effort=30.0).replace('name="arm"', 'name="arm" actuatorfrcrange="-20 20"')
    twice = clamped.replace("</actuator>", '<motor name="second" joint="arm" ctrlrange="-9 9"/></actuator>')
    (tmp_path / "arm.xml").write_text(twice, encoding="utf-8")
    code, out, _ = ask("new", str(tmp_path / "arm.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 0
    assert "plans neglect forces that act in the simulation: actuatorfrcrange of joint arm" in out
    written = tomllib.loads((tmp_path / "first.toml").read_text(encoding="utf-8"))
    assert written["limits"]["unhonoured"] == "note"
    assert written["motion"]["goal_deg"] != written["motion"]["start_deg"]


CABLES = """<mujoco><default><geom contype="0" conaffinity="0"/></default><worldbody><body name="arm">
<joint name="elbow" axis="0 1 0" range="-60 60"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/></body>
</worldbody><actuator><motor name="flexor" joint="elbow" gear="-10" ctrlrange="0 {most}"/>
<motor name="extensor" joint="elbow" gear="10" ctrlrange="0 {most}"/></actuator></mujoco>"""


@pytest.mark.parametrize(("most", "raised"), [(1.0, None), (0.05, 0.294)])
def test_of_two_cables_one_pulls_and_the_other_need_not_push(tmp_path, ask, most, raised):
    """1 kg at 0.15 m needs 1.47 N.m: 0.147 of the flexor, whose limit below that becomes twice as much."""
    (tmp_path / "arm.xml").write_text(CABLES.format(most=most), encoding="utf-8")
    code, out, _ = ask("new", str(tmp_path / "arm.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 0, out
    limits = tomllib.loads((tmp_path / "first.toml").read_text(encoding="utf-8")).get("limits", {})
    assert limits.get("effort", {}).get("flexor") == (None if raised is None else [0.0, raised])


WAIST = """<mujoco><compiler autolimits="true"/><default><joint axis="0 1 0" range="-90 90"/></default><worldbody>
<body pos="-1 0 0"><joint name="left"/><inertial pos="0 0 0" mass="0.1" diaginertia="0.01 0.01 0.01"/></body>
<body><joint name="roll"/><inertial pos="0 0 0.3" mass="1" diaginertia="0.1 0.1 0.1"/>
<body pos="0 0 0.3"><joint name="neck"/><inertial pos="0 0 0.1" mass="0.2" diaginertia="0.01 0.01 0.01"/></body></body>
</worldbody><tendon><fixed name="coupling" range="-{play} {play}"><joint joint="left" coef="0.5"/>
<joint joint="roll" coef="1"/></fixed></tendon>
<actuator><motor joint="left" ctrlrange="-9 9"/><motor joint="neck" ctrlrange="-9 9"/></actuator>{rest}</mujoco>"""
NARROW = WAIST.replace("{play}", "0.001")


@pytest.mark.parametrize(
    ("model", "dof"),
    [
        (WAIST.format(play=1.0, rest=""), 3),
        (NARROW.format(rest=""), 2),
        (NARROW.format(rest='<equality><tendon tendon1="coupling"/></equality>'), 2),
    ],
)
def test_tendons_with_ranges_or_an_equality_lock_no_joint(model, dof):
    mechanism, notes = changed_mechanism({"model": model})
    assert (mechanism.dof, notes) == (dof, ())
