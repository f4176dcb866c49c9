"""One leg out of a robot: what is kept, locked and dropped, and that the leg is the robot's own."""

import mujoco
import numpy as np
import pytest

import linkplan
from linkplan.cli.main import main
from linkplan.models.errors import LinkplanError
from linkplan.models.library import compile_model
from linkplan.models.selected_model import whole_model_text
from linkplan.models.selection import Selection
from tests.support.linkages import ROD
from tests.support.refusals import assert_refused

# A floating body with an arm and two legs. A leg is a driven thigh, and a driven crank whose rod moves the shank. The arm is
# one body with three joints, in a frame.
LEG = """
<body name="{side} thigh" pos="0 {y} -0.1">
  <joint name="{side} hip" axis="0 1 0" range="-60 60" armature="0.01"/>
  <inertial pos="0.01 0 -0.15" mass="3" diaginertia="0.03 0.03 0.003"/>
  <body name="{side} crank" pos="0 0 -0.05">
    <joint name="{side} motor" axis="0 1 0" range="-50 50" armature="0.02"/>
    <inertial pos="0.02 0 0" mass="0.2" diaginertia="1e-4 1e-4 1e-4"/>
    <body name="{side} rod" pos="0.06 0 0">
      <joint name="{side} rod pin" axis="0 1 0"/>
      <inertial pos="0 0 -0.12" mass="0.1" diaginertia="5e-4 5e-4 1e-5"/>
    </body>
  </body>
  <body name="{side} shank" pos="0 0 -0.3">
    <joint name="{side} knee" axis="0 1 0"/>
    <inertial pos="0.01 0 -0.1" mass="1.5" diaginertia="0.02 0.02 0.001"/>
    <geom name="{side} foot" type="sphere" size="0.03" pos="0 0 -0.28" mass="0.1"/>
  </body>
</body>
"""
CROUCH = "0.5 0 0.8 0.98480775 0 0.17364818 0  0.35 0 0 0  0 0 0 0  0 0 0"
ROBOT = f"""
<mujoco model="robot">
  <compiler angle="degree" autolimits="true"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="pelvis" pos="0 0 1" euler="0 10 0">
      <freejoint name="base"/>
      <inertial pos="0 0 0" mass="10" diaginertia="0.1 0.1 0.1"/>
      {LEG.format(side="left", y=0.1)}
      {LEG.format(side="right", y=-0.1)}
      <frame pos="0 0 0.2" euler="0 0 30">
        <body name="arm" pos="0 0.2 0" euler="0 20 0">
          <joint name="shoulder roll" axis="1 0 0"/>
          <joint name="shoulder pitch" axis="0 1 0" pos="0 0 0.02" ref="5"/>
          <joint name="shoulder yaw" axis="0 0 1"/>
          <inertial pos="0.02 0 -0.2" mass="1" diaginertia="0.01 0.01 0.001"/>
        </body>
      </frame>
    </body>
  </worldbody>
  <equality>
    <connect name="left pin" body1="left rod" body2="left shank" anchor="0 0 -0.25"/>
    <connect name="right pin" body1="right rod" body2="right shank" anchor="0 0 -0.25"/>
  </equality>
  <actuator>
    <motor name="left hip" joint="left hip" ctrlrange="-100 100"/>
    <motor name="left motor" joint="left motor" ctrlrange="-100 100"/>
    <motor name="right hip" joint="right hip" ctrlrange="-100 100"/>
    <motor name="right motor" joint="right motor" ctrlrange="-100 100"/>
    <motor name="arm" joint="shoulder pitch" ctrlrange="-10 10"/>
  </actuator>
  <sensor><actuatorfrc actuator="right hip"/><jointpos joint="left hip"/></sensor>
  <keyframe><key name="crouch" qpos="{CROUCH}"/></keyframe>
</mujoco>
"""


def joint_names(model: mujoco.MjModel) -> list[str]:
    return [model.joint(j).name for j in range(model.njnt)]


def selected(**asked) -> mujoco.MjModel:
    return compile_model(ROBOT, None, Selection(**asked))[1]


def inertia_and_bias(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M (n_v, n_v) and the bias (n_v,)."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    columns = []
    for unit in np.eye(model.nv):
        columns.append(np.zeros(model.nv))
        mujoco.mj_mulM(model, data, columns[-1], unit)
    return np.array(columns), np.array(data.qfrc_bias)


def assert_same_dynamics(part: mujoco.MjModel, fixed: dict[str, list[float]]) -> None:
    """Compare a part's inertia and bias with the robot's, whose other joints stand at `fixed` or at their reference."""
    whole, rng = compile_model(ROBOT)[1], np.random.default_rng(0)
    for qpos in rng.uniform(-0.4, 0.4, (5, part.nq)):
        qvel = rng.uniform(-1, 1, part.nv)
        whole_qpos, whole_qvel, dofs = np.array(whole.qpos0), np.zeros(whole.nv), []
        for name, value in fixed.items():
            at = int(whole.jnt_qposadr[whole.joint(name).id])
            whole_qpos[at : at + len(value)] = value
        for name in joint_names(part):
            joint, own = whole.joint(name).id, part.joint(name).id
            whole_qpos[whole.jnt_qposadr[joint]] = qpos[part.jnt_qposadr[own]]
            dofs.append(int(whole.jnt_dofadr[joint]))
            whole_qvel[dofs[-1]] = qvel[part.jnt_dofadr[own]]
        M, bias = inertia_and_bias(whole, whole_qpos, whole_qvel)
        M_part, bias_part = inertia_and_bias(part, qpos, qvel)
        np.testing.assert_allclose(M_part, M[np.ix_(dofs, dofs)], atol=1e-12)
        np.testing.assert_allclose(bias_part, bias[dofs], atol=1e-10)


def test_a_kept_joint_brings_its_leg_and_its_loop_and_nothing_else():
    part = selected(keep=("left hip",), fix_base=True)
    assert joint_names(part) == ["left hip", "left motor", "left rod pin", "left knee"]
    assert (part.nu, part.neq, part.nsensor) == (2, 1, 1)
    assert_same_dynamics(part, {})


def test_a_loop_brings_the_chain_at_its_other_end():
    part = selected(keep=("left crank",), fix_base=True)
    assert joint_names(part) == ["left motor", "left rod pin", "left knee"]  # the shank, and not the hip


def test_a_fixed_base_stands_where_the_keyframe_puts_it():
    part = selected(keep=("left hip",), fix_base=True, keyframe="crouch")
    assert_same_dynamics(part, {"base": [0.5, 0, 0.8, 0.98480775, 0, 0.17364818, 0]})
    np.testing.assert_allclose(part.key("home").qpos, [0.35, 0, 0, 0])


@pytest.mark.parametrize("name", ["shoulder roll", "shoulder pitch", "shoulder yaw"])
def test_a_locked_joint_among_others_of_its_body_leaves_their_dynamics(name):
    part = selected(keep=("arm",), fix_base=True, lock={name: 25.0})
    assert name not in joint_names(part)
    assert_same_dynamics(part, {name: [np.radians(25.0)]})


def test_a_loop_closes_where_it_did_when_one_of_its_joints_is_locked():
    leg = linkplan.load_mechanism(ROBOT, keep=["left hip"], fix_base=True, lock={"left motor": 20.0})
    assert (leg.dof, leg.n_u) == (1, 1)
    robot = compile_model(ROBOT)[1]
    data = mujoco.MjData(robot)
    for joint, position in zip(leg.joints, leg.home, strict=True):
        data.qpos[robot.jnt_qposadr[robot.joint(joint.name).id]] = position
    data.qpos[robot.jnt_qposadr[robot.joint("left motor").id]] = np.radians(20.0)
    mujoco.mj_forward(robot, data)
    assert np.abs(data.efc_pos[:3]).max() < 1e-9  # the robot's own loop is closed at the leg's home pose


def test_joints_without_names_are_named_by_their_numbers_in_the_compiled_model():
    """A body's joint that stands behind the body's children in the file still has the smaller number."""
    text = """<mujoco><worldbody><body name="a"><geom size=".1"/>
        <body name="b"><geom size=".1"/><joint axis="0 1 0"/></body>
        <joint axis="1 0 0"/></body>
        <body name="c"><geom size=".1"/><joint name="turn" axis="0 0 1"/></body></worldbody></mujoco>"""
    part = compile_model(text, selection=Selection(keep=("a",)))[1]
    assert {name: part.joint(name).axis.tolist() for name in joint_names(part)} == {"joint0": [1, 0, 0], "joint1": [0, 1, 0]}


def test_notes_name_what_was_locked_and_dropped():
    notes = " | ".join(linkplan.load_mechanism(ROBOT, keep=["left crank"], fix_base=True).notes)
    assert "locked: base at home; left hip at 0 deg" in notes
    assert "dropped with the locked joints: actuator left hip" in notes
    assert "dropped with everything attached to them (5 bodies, 5.8 kg): right thigh, arm" in notes
    assert "without the world's floor" in notes


def test_the_selected_model_s_text_is_the_same_machine_to_the_last_digit():
    leg = linkplan.load_mechanism(ROBOT, keep=["left hip"], fix_base=True, keyframe="crouch", lock={"left motor": 7.0})
    again = linkplan.load_mechanism(whole_model_text(leg))
    np.testing.assert_allclose(again.model.body_pos, leg.model.body_pos, rtol=0, atol=1e-16)
    np.testing.assert_allclose(again.home, leg.home, atol=1e-12)


def test_a_selection_stands_in_the_problem_and_in_its_saved_plan(tmp_path):
    (tmp_path / "robot.xml").write_text(ROBOT, encoding="utf-8")
    leg = linkplan.load_mechanism(tmp_path / "robot.xml", keep=["left hip"], fix_base=True, lock={"left motor": 3.0})
    problem = linkplan.Problem.reach(leg, start_deg={"left hip": 0.0}, goal_deg={"left hip": 5.0}, duration_s=0.5)
    linkplan.plan(problem).save(tmp_path / "plan")
    again = linkplan.read_plan(tmp_path / "plan").problem.mechanism
    assert {key: again.source[key] for key in ("keep", "fix_base", "lock")} == {
        "keep": ["left hip"],
        "fix_base": True,
        "lock": {"left motor": 3.0},
    }
    assert again.dof == 1


def test_check_writes_the_selected_model(capsys, tmp_path):
    (tmp_path / "robot.xml").write_text(ROBOT, encoding="utf-8")
    options = ("--keep", "left hip", "--fix-base", "--lock", "left motor=4", "--keyframe", "crouch")
    main(["check", str(tmp_path / "robot.xml"), *options, "-o", str(tmp_path / "out")])
    assert "left motor at 4 deg" in capsys.readouterr().out
    assert linkplan.load_mechanism(tmp_path / "out" / "selected.xml").dof == 1


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"keep": ["left hipp"]}, ["mechanism.keep", "left hipp", "did you mean 'left hip'"]),
        ({"lock": {"elbow": 1.0}}, ["joint in mechanism.lock", "elbow", "legal: base, left hip"]),
        ({"lock": {"base": 1.0}}, ["base", "free joint", "fix_base"]),
        ({"keyframe": "stand"}, ["unknown keyframe 'stand'", "crouch"]),
        ({"keep": []}, ["mechanism.keep"]),
        ({"fix_base": 1}, ["fix_base", "true or false"]),
    ],
)
def test_a_wrong_selection_is_refused_in_one_line(asked, words):
    assert_refused(lambda: linkplan.load_mechanism(ROBOT, **asked), *words)


# A waist that two joints on the pelvis drive through tendon couplings, as differential drives are often modelled; a pair for
# contact names the floor.
COUPLED_WAIST = """<mujoco model="waist"><compiler angle="degree"/><worldbody><geom name="floor" type="plane" size="0 0 1"/>
  <body name="pelvis" pos="0 0 1"><freejoint/><geom size=".05"/>
    <body name="drive"><joint name="drive" axis="1 0 0"/><geom size=".02"/></body>
    <body name="waist"><joint name="waist" axis="1 0 0"/><geom size=".03"/>
      <body name="leg" pos="0 0 -.1"><joint name="hip" axis="0 1 0"/>
        <geom name="foot" type="capsule" size=".01" fromto="0 0 0 .1 0 -.2"/></body></body></body></worldbody>
  <contact><pair geom1="floor" geom2="foot"/></contact>
  <tendon><fixed name="differential"><joint joint="drive" coef="1"/><joint joint="waist" coef="-2"/></fixed></tendon>
  <equality><tendon name="geared" tendon1="differential"/></equality>
  <actuator><motor name="drive" joint="drive" ctrlrange="-1 1"/><motor name="hip" joint="hip" ctrlrange="-9 9"/></actuator>
  </mujoco>"""


def test_couplings_of_locked_and_dropped_joints_and_pairs_with_the_ground_are_dropped():
    _, model, notes = compile_model(COUPLED_WAIST, None, Selection(keep=("hip",), fix_base=True))
    assert [model.joint(j).name for j in range(model.njnt)] == ["hip"]
    assert (model.ntendon, model.neq, model.npair, model.nu) == (0, 0, 0, 1)
    assert any("tendon differential" in note for note in notes)


def test_a_joint_whose_coupling_moves_a_free_one_cannot_be_locked():
    with pytest.raises(LinkplanError, match="'waist' cannot be locked: tendon 'differential'"):
        compile_model(COUPLED_WAIST, None, Selection(lock={"waist": 0.0}))


def test_the_gear_that_drives_a_kept_joint_is_kept_with_its_motor():
    geared = COUPLED_WAIST.replace("<equality>", '<equality><joint name="gears" joint1="hip" joint2="pinion"/>').replace(
        '<body name="drive">',
        '<body name="pinion"><joint name="pinion" axis="0 1 0"/><geom size=".02"/></body><body name="drive">',
    )
    geared = geared.replace('<motor name="hip" joint="hip"', '<motor name="pinion" joint="pinion"')
    _, model, _ = compile_model(geared, None, Selection(keep=("hip",), fix_base=True))
    assert {model.joint(j).name for j in range(model.njnt)} == {"hip", "pinion"}
    assert (model.neq, model.nu) == (1, 1)


def test_two_bodies_pass_through_each_other_when_their_contacts_are_excluded():
    text = "<mujoco><worldbody>{}{}</worldbody><actuator><motor joint='a'/><motor joint='b'/></actuator></mujoco>".format(
        *(
            f"<body name='link {name}'><joint name='{name}' axis='0 1 0'/><geom size='0.1' pos='0 0 -0.2'/></body>"
            for name in "ab"
        )
    )
    for pairs, contacts in (((), 1), ((("link a", "link b"),), 0)):
        model = linkplan.load_mechanism(text, exclude_contacts=pairs).model
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon == contacts
    with pytest.raises(LinkplanError, match=r"in mechanism.exclude_contacts 'link c'.*link a, link b"):
        linkplan.load_mechanism(text, exclude_contacts=[("link a", "link c")])


@pytest.mark.parametrize(
    "asked", [{}, {"fix_base": True}, {"fix_base": True, "keep": ["hip"]}, {"fix_base": True, "lock": {"hip": 0.0}}]
)
def test_what_hangs_on_a_fixed_base_collides_with_what_it_did_before(asked):
    """MuJoCo filters the contacts of a body with its parent, but not of one whose parent stands still."""
    part = linkplan.load_mechanism(
        """
<mujoco><default><geom type="capsule"/></default><worldbody>
<body name="base"><freejoint/><geom fromto="0 0 0 0 0 0.1" size="0.1"/>
<body name="thigh"><joint name="hip" axis="0 1 0"/><geom fromto="0 0 0 0 0 -0.3" size="0.05"/>
<body name="shank"><joint name="knee" axis="0 1 0"/><geom fromto="0 0 0 0 0 -0.2" size="0.02"/></body></body></body>
</worldbody><actuator><motor joint="hip"/><motor joint="knee"/></actuator></mujoco>""",
        **asked,
    ).model
    data = mujoco.MjData(part)
    mujoco.mj_forward(part, data)
    touching = {frozenset(part.body(part.geom_bodyid[g]).name for g in contact.geom) for contact in data.contact}
    assert touching == {frozenset(("base", "shank"))}


@pytest.mark.parametrize("wrong", ["link a", ["link a", "link b"], [["link a"]], [["link a", 1]]])
def test_pairs_of_another_form_are_answered_with_an_example(wrong):
    tables = {"mechanism": {"model": "five-bar", "exclude_contacts": wrong}, "motion": {"kind": "reach"}}
    with pytest.raises(
        LinkplanError, match=r'exclude_contacts.* a list of pairs of names of bodies, such as \[\["base", "rod"\]\]'
    ):
        linkplan.Problem.from_tables("wrong", tables)


def test_a_rod_without_its_spin_is_the_same_linkage():
    whole, locked = linkplan.load_mechanism(ROD), linkplan.load_mechanism(ROD, lock_spin=["ball"])
    assert (whole.dof, locked.dof) == (2, 1)
    assert [joint.name for joint in locked.joints] == ["drive", "ball_1", "ball_2", "swing"]
    assert "locked: ball against spin about the line of its rod" in locked.notes
    drive = whole.independent_joints.index(next(joint for joint in whole.independent_joints if joint.name == "drive"))
    speed, rate = np.zeros(2), np.array([1.3])
    speed[drive] = rate[0]
    ends = []
    for mechanism, v in ((whole, speed), (locked, rate)):
        model, data = mechanism.model, mujoco.MjData(mechanism.model)
        data.qpos[:] = mechanism.qpos_of(mechanism.home)
        data.qvel[:] = mechanism.qvel_of(mechanism.home, np.array(mechanism.dynamics.velocity_map(mechanism.home)) @ v)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        ends.append([data.site("pin").xpos.copy(), data.joint("swing").qvel.copy()])
    np.testing.assert_allclose(ends[0][0], ends[1][0], atol=1e-12)
    np.testing.assert_allclose(ends[0][1], ends[1][1], atol=1e-9)
    still = [np.zeros(2), np.zeros(1)]
    hold = [
        np.array(m.dynamics.inverse_dynamics(m.home, rest, rest)).ravel()[0]
        for m, rest in zip((whole, locked), still, strict=True)
    ]
    assert hold[0] == pytest.approx(hold[1], rel=1e-9)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (("ball", "drive"), "'drive' is not a ball joint"),
        (('damping=".01"', 'damping=".01" stiffness="1"'), "'ball' has a spring or a range"),
        (('<site name="end" pos="0 .05 .2"/>', '<site name="end" pos="0 .05 .2"/><body pos="0 0 .1"><joint name="flap"/>'
          '<geom size=".01" pos=".1 0 0"/></body>'), "'ball' carries no rod"),
    ],
)  # fmt: skip
def test_a_spin_that_is_none_is_refused(changed, words):
    text, name = (ROD, changed[1]) if changed[0] == "ball" else (ROD.replace(*changed), "ball")
    with pytest.raises(LinkplanError, match=words):
        linkplan.load_mechanism(text, lock_spin=[name])
    with pytest.raises(LinkplanError, match=r"unknown joint in mechanism.lock_spin 'bal' \(did you mean 'ball'\?\)"):
        linkplan.load_mechanism(ROD, lock_spin=["bal"])


def test_a_universal_joint_has_no_range_where_a_default_limits_all_joints():
    limited = ROD.replace("<worldbody>", '<default><joint limited="true" range="-90 90"/></default><worldbody>').replace(
        'type="ball"', 'type="ball" limited="false"'
    )
    unset = limited.replace(' range="-90 90"', "").replace('name="drive"', 'name="drive" limited="false"')
    unset = unset.replace('name="swing"', 'name="swing" limited="false"')
    for model in (limited, unset):
        rod = linkplan.load_mechanism(model, lock_spin=["ball"])
        assert not rod.model.joint("ball_1").limited
        assert not rod.model.joint("ball_2").limited


def test_a_locked_link_on_a_body_that_the_compiler_fuses_stays_where_it_stood():
    """`fusestatic`, which is on for URDF, merges the bracket into the world: the upper link becomes a child of the world."""
    arm = """<mujoco><compiler fusestatic="true"/><worldbody>
      <body name="bracket" pos="0.1 0.2 0.3" euler="90 0 0">
        <body name="upper" pos="0 0 0.5" euler="0 20 0"><joint name="shoulder" axis="0 1 0"/>
          <inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/>
          <body name="lower" pos="0 0 0.4"><joint name="elbow" axis="0 1 0"/>
            <inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/></body></body></body>
    </worldbody></mujoco>"""
    places = []
    for selection in (Selection(), Selection(keep=["lower"], fix_base=True), Selection(lock={"shoulder": 0.0})):
        model = compile_model(arm, selection=selection)[1]
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        places.append(np.append(data.body("lower").xpos, data.body("lower").xmat))
    assert places[1] == pytest.approx(places[0], abs=1e-12)
    assert places[2] == pytest.approx(places[0], abs=1e-12)
