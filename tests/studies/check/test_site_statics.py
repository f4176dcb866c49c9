"""What sites do for efforts, and efforts for sites, against levers, wheel rates, differences and linear programs."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.poses.assembly import close_at

# A lever of 0.5 m with a mass of 2 kg at its end, a spring to a point 0.2 m along it, and a motor of 30 N.m at its pin.
LEVER = """<mujoco><worldbody><site name="ground" pos="0.2 0 -0.3"/><body name="arm">
<joint name="A" axis="0 -1 0" range="-40 40"/><inertial pos="0.5 0 0" mass="2" diaginertia="1e-9 1e-9 1e-9"/>
<site name="end" pos="0.5 0 0"/><site name="seat" pos="0.2 0 0"/></body></worldbody><tendon>
<spatial name="s" stiffness="{stiffness}" springlength="0.3"><site site="ground"/><site site="seat"/></spatial></tendon>
<actuator><motor name="m" joint="A" ctrlrange="-30 30"/></actuator></mujoco>"""
# A beam of 1 m on two rams of 500 N, without mass but for a kilogram at its middle.
BEAM = """<mujoco><worldbody><body name="left"><joint name="L" type="slide" axis="0 0 1" range="-0.2 0.2"/>
<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/><body name="beam"><joint name="tilt" axis="0 -1 0"/>
<inertial pos="0.5 0 0" mass="1" diaginertia="1e-3 1e-3 1e-3"/>
<site name="load" pos="0.3 0 0"/><site name="b" pos="1 0 0"/></body></body>
<body name="right" pos="1 0 0"><joint name="R" type="slide" axis="0 0 1" range="-0.2 0.2"/>
<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/>
<body name="shoe"><joint name="play" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/><site name="r"/>
</body></body></worldbody><equality><connect site1="b" site2="r"/></equality>
<actuator><motor name="l" joint="L" ctrlrange="-500 500"/>
<motor name="r" joint="R" ctrlrange="-500 500"/></actuator></mujoco>"""
Z = 2


def site(found, name: str, path: str = "the poses asked for"):
    return next(one for one in found.sites if (one.site, one.path) == (name, path))


def test_a_level_lever_has_its_arm_its_wheel_rate_and_its_mass():
    found = linkplan.check(LEVER.format(stiffness=1000), at_deg=[0.0], sites=True)
    end = site(found, "end")
    assert end.rate["m"][0, Z] == pytest.approx(0.5)
    assert end.effort_per_n["m"][0, Z] == pytest.approx(0.5)
    assert end.mass_kg[0, Z] == pytest.approx(2.0)
    # 1000 N/m at 0.2 of 0.5 m; the weight of a level lever has no slope, and the free spring no force.
    assert end.stiffness_n_m[0, Z] == pytest.approx(1000 * (0.2 / 0.5) ** 2)
    weight = 2 * 9.81
    np.testing.assert_allclose(end.force_n[0, Z], [-30 / 0.5 - weight, 30 / 0.5 - weight], rtol=1e-9)
    assert end.axes == [Z]


def test_a_load_on_a_beam_is_shared_by_its_rams_as_by_a_lever():
    found = linkplan.check(BEAM, at_m=[{"L": 0.0, "R": 0.0}], site_force_n={"load": [0.0, 0.0, -100.0]})
    effort = site(found, "load").given_effort
    half = 0.5 * 9.81
    assert effort["l"][0] == pytest.approx(70 + half, rel=1e-5)
    assert effort["r"][0] == pytest.approx(30 + half, rel=1e-5)
    assert site(found, "load").missed["L"][0] == 0.0
    # Both rams push on it until the left one is at its limit: 500 = 0.7 f + weight / 2.
    np.testing.assert_allclose(site(found, "load").force_n[0, Z, 1], (500 - half) / 0.7, rtol=1e-5)


def test_a_force_beyond_the_limits_is_said_with_what_is_missing():
    found = linkplan.check(LEVER.format(stiffness=0), at_deg=[0.0], site_force_n={"end": [0.0, 0.0, -100.0]})
    assert site(found, "end").missed["A"][0] == pytest.approx(0.5 * (100 + 2 * 9.81) - 30)
    texts = [block.text for block in found.blocks() if hasattr(block, "text")]
    assert any("cannot hold this force at" in text for text in texts)


def test_rates_of_a_closed_chain_are_differences_of_places():
    mechanism = linkplan.load_mechanism("five-bar")
    found = linkplan.check(mechanism, at_deg=[{"O1": -105.0, "O2": -90.0}], sites=True)
    one = next(one for one in found.sites if one.path == "the poses asked for" and one.axes)
    k = int(mechanism.model.site(one.site).id)
    s = np.radians([-105.0, -90.0])
    for column, motor in enumerate(one.rate):
        step = 1e-6 * np.eye(2)[column]
        after, before = (mechanism.dynamics.site_places(close_at(mechanism, s + d)).full()[:, k] for d in (step, -step))
        np.testing.assert_allclose(one.rate[motor][0], (after - before) / 2e-6, atol=1e-8)


def test_pushes_of_redundant_motors_are_those_of_one_motor_of_their_strength():
    double = LEVER.replace("</actuator>", '<motor name="other" joint="A" ctrlrange="-10 20"/></actuator>')
    one = LEVER.replace('ctrlrange="-30 30"', 'ctrlrange="-40 50"')
    found = [site(linkplan.check(text.format(stiffness=300), at_deg=[20.0], sites=True), "end") for text in (double, one)]
    np.testing.assert_allclose(found[0].force_n, found[1].force_n, rtol=1e-9)
    assert list(found[0].rate) == ["A"]  # neither motor turns alone


@pytest.mark.parametrize(
    ("force", "words"),
    [
        ({"nowhere": [0, 0, 1]}, "end, seat"),
        ({"end": [0, 1]}, "three finite numbers"),
        ({"end": [0, 0, np.nan]}, "three finite"),
    ],
)
def test_forces_on_no_site_are_refused(force, words):
    with pytest.raises(ProblemError, match=words):
        linkplan.check(LEVER.format(stiffness=0), site_force_n=force)
