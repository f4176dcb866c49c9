"""`new` of mechanisms that nothing can move: what is offered, and what is said of the actuators that they have."""

# An arm of one joint, without a name, and without a motor.
ARM = """<mujoco><worldbody><body><joint axis="0 1 0"/>
  <inertial pos="0.5 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""


def test_an_actuator_is_offered_with_a_name_for_a_joint_that_has_none(tmp_path, ask):
    (tmp_path / "arm.xml").write_text(ARM, encoding="utf-8")
    code, _, err = ask("new", str(tmp_path / "arm.xml"), "-o", str(tmp_path / "first.toml"))
    assert code == 2
    assert (
        'add for example name="joint0" to its first joint, which has no name, and <actuator><motor name="act_joint0"' in err
    )
    assert 'mechanism.drive = ["joint0"] puts motors' in err
    code, found, _ = ask("new", str(tmp_path / "arm.xml"), "--drive", "joint0", "-o", str(tmp_path / "first.toml"))
    assert (code, found.splitlines()[-1]) == (0, "Planned")


def test_actuators_that_no_plan_can_use_are_counted_and_not_listed(tmp_path, ask):
    links = "".join(f'<body><joint name="j{k}" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body>' for k in range(6))
    muscles = "".join(f'<muscle name="m{k}" joint="j{k}" lengthrange="0 1"/>' for k in range(6))
    model = f"<mujoco><worldbody>{links}</worldbody><actuator>{muscles}</actuator></mujoco>"
    (tmp_path / "pulled.xml").write_text(model, encoding="utf-8")
    code, _, err = ask("new", str(tmp_path / "pulled.xml"))
    assert code == 2
    assert "actuator m0 on joint j0" in err
    assert "(and 5 more of this kind)" in err
    assert "m1" not in err
