"""Sites along a reach, motion ratios of springs and poses in balance, against closed forms of an arm and a pendulum."""

import numpy as np
import pytest
import scipy

from linkplan import check
from linkplan.models.mechanism import load_mechanism
from linkplan.models.selection import Selection
from linkplan.studies.check.spring_ratios import sprung_tendons

FRAME, SHOCK, WHEEL = np.array([0.1, 0.05]), np.array([0.25, -0.02]), np.array([0.5, 0.0])
STIFFNESS, REST, MASS = 2500.0, 0.1, 6.0
SWINGARM = f"""<mujoco><worldbody><site name="frame" pos="0.1 0 0.05"/><body name="arm">
<joint name="pivot" axis="0 -1 0" range="-25 25"/><geom type="box" size="0.25 0.01 0.01" pos="0.25 0 0" mass="{MASS}"/>
<site name="shock" pos="0.25 0 -0.02"/><site name="wheel" pos="0.5 0 0"/></body></worldbody>
<tendon><spatial name="spring" stiffness="{STIFFNESS}" springlength="{REST}">
<site site="frame"/><site site="shock"/></spatial>
<spatial name="cable"><site site="frame"/><site site="wheel"/></spatial></tendon>
<actuator><motor name="lift" joint="pivot" ctrlrange="-50 50"/></actuator></mujoco>"""
PENDULUM = """<mujoco><option gravity="{gravity} 0 -9.81"/><worldbody><body name="rod"><joint name="J" axis="0 1 0"/>
<inertial pos="0 0 -0.5" mass="1" diaginertia="0.01 0.01 0.01"/><site name="tip" pos="0 0 -1"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-9 9"/></actuator></mujoco>"""


def turned(angle: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the place (n, 2) of a point of the arm, x and z, at angles (n,) [rad] from x to z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * point[0] - s * point[1], s * point[0] + c * point[1]], axis=-1)


def length(angle: np.ndarray) -> np.ndarray:
    return np.linalg.norm(turned(angle, SHOCK) - FRAME, axis=-1)


def energy(angle: float) -> float:
    return 9.81 * MASS * 0.25 * np.sin(angle) + 0.5 * STIFFNESS * (float(length(np.array(angle))) - REST) ** 2


def along(mechanism):
    """Return what `check` finds along the reach of a mechanism of one degree of freedom."""
    (path,) = check(mechanism).struct.along
    return path


def test_lengths_and_motion_ratios_of_a_spring_are_those_of_the_law_of_cosines():
    path = along(load_mechanism(SWINGARM))
    angle = np.radians(path.q_deg["pivot"])
    np.testing.assert_allclose(path.spring_length_m["spring"], length(angle), rtol=1e-12)
    a, b = np.linalg.norm(SHOCK), np.linalg.norm(FRAME)
    between = angle + np.arctan2(*SHOCK[::-1]) - np.arctan2(*FRAME[::-1])
    ratio = a * b * np.sin(between) / np.sqrt(a**2 + b**2 - 2 * a * b * np.cos(between))
    assert np.ptp(ratio) > 0.05
    np.testing.assert_allclose(path.spring_motion_ratio["spring"]["pivot"], ratio, atol=1e-12)
    assert list(path.spring_length_m) == ["spring"], "a cable without a spring is none"


def test_a_pose_in_balance_is_where_the_energy_has_no_slope():
    (one,) = along(load_mechanism(SWINGARM)).balance
    found = scipy.optimize.minimize_scalar(energy, bounds=np.radians([-25, 25]), method="bounded", options={"xatol": 1e-12})
    assert one["stable"]
    assert one["unit"] == "deg"
    assert one["position"] == pytest.approx(np.degrees(found.x), abs=1e-4)


def test_a_pendulum_hangs_stably_and_stands_unstably():
    path = along(load_mechanism(PENDULUM.format(gravity=0.0)))
    found = {round(one["position"] % 360, 6): one["stable"] for one in path.balance}
    assert found == {0.0: True, 180.0: False}


def test_a_constant_force_moves_the_balance_to_the_direction_of_the_whole_load():
    """The rod points along the sum of its weight at half its length and the force at its end."""
    push = 3.0
    path = along(load_mechanism(PENDULUM.format(gravity=0.0), selection=Selection(force={"tip": (push, 0.0, 0.0)})))
    stable = [one["position"] for one in path.balance if one["stable"]]
    lean = np.degrees(np.arctan2(push, 0.5 * 9.81))
    assert stable[0] % 360 == pytest.approx(360 - lean, abs=1e-6), "turning from z to x carries the tip to -x"


def test_where_nothing_pulls_no_pose_is_in_balance():
    flat = PENDULUM.format(gravity=0.0).replace('axis="0 1 0"', 'axis="0 0 1"')
    assert along(load_mechanism(flat)).balance == []


def test_the_report_names_them():
    text = str(check(load_mechanism(SWINGARM)))
    for words in ("length spring [m]", "spring per pivot [m]", "wheel z [m]", "in balance, without effort on pivot"):
        assert words in text
    assert list(sprung_tendons(load_mechanism(SWINGARM).model)) == ["spring"]
