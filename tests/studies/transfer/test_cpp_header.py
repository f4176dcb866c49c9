"""The C++ header of a transfer table, compiled without ROS: interpolation, both directions, power balance."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

import linkplan
from linkplan.studies.handover.transfer.cpp_header import cpp_header
from tests.support import parallel_ankle

needs_gxx = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no g++")
ANKLE = ["ankle_pitch", "ankle_roll"]
_WRAPPED = """
#include "transmission.hpp"
namespace linkage = linkage_ankle_pitch_ankle_roll;
using linkage::Transmission;
extern "C" {
int map_at(const double *s, double *motor, double *ratio)
{
  Transmission t;
  if (!t.at(s)) return 0;
  for (int j = 0; j < linkage::kMotors; ++j) motor[j] = t.motor_position()[j];
  for (int j = 0; j < linkage::kMotors; ++j)
    for (int i = 0; i < linkage::kJoints; ++i) ratio[linkage::kJoints * j + i] = t.ratio(j, i);
  return 1;
}
int velocities(const double *s, const double *v, double *motor, double *back)
{
  Transmission t;
  if (!t.at(s)) return 0;
  t.joint_to_motor_velocity(v, motor);
  return t.motor_to_joint_velocity(motor, back);
}
int efforts(const double *s, const double *u, double *joint, double *back)
{
  Transmission t;
  if (!t.at(s)) return 0;
  t.motor_to_joint_effort(u, joint);
  return t.joint_to_motor_effort(joint, back);
}
int positions(const double *motor, double *s) { Transmission t; return t.motor_to_joint_position(motor, s); }
}
"""


@pytest.fixture(scope="module")
def table():
    return linkplan.transfer(linkplan.load_mechanism(parallel_ankle.ankle_text()), ANKLE, tolerance=0.01)


@pytest.fixture(scope="module")
def compiled(table, tmp_path_factory):
    """Return the header's functions, compiled without a warning."""
    folder = tmp_path_factory.mktemp("cpp")
    (folder / "transmission.hpp").write_text(cpp_header(table.found))
    (folder / "t.cpp").write_text(_WRAPPED)
    words = ["g++", "-std=c++17", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC", str(folder / "t.cpp")]
    subprocess.run([*words, "-o", str(folder / "t.so")], check=True)
    return ctypes.CDLL(str(folder / "t.so"))


def call(function, *arrays: np.ndarray) -> int:
    return function(*[ctypes.c_void_p(array.ctypes.data) for array in arrays])


POINTS = np.random.default_rng(8).uniform([-0.69, -0.34], [0.49, 0.34], (200, 2))


@needs_gxx
def test_it_interpolates_as_the_table_does(table, compiled):
    motors, ratios = table.at("motor_position", POINTS), table.at("ratio", POINTS)
    for s, motor, ratio in zip(POINTS, motors, ratios, strict=True):
        found, G = np.empty(2), np.empty(4)
        assert call(compiled.map_at, s, found, G)
        np.testing.assert_allclose(found, motor, atol=1e-14)
        np.testing.assert_allclose(G.reshape(2, 2), ratio, atol=1e-14)


@needs_gxx
def test_motor_power_is_joint_power_and_the_way_back_is_exact(compiled):
    random, worst, largest = np.random.default_rng(9), 0.0, 0.0
    for s in POINTS:
        v, u = random.normal(size=2), random.normal(size=2)
        motor, v_back, joint, u_back = (np.empty(2) for _ in range(4))
        assert call(compiled.velocities, s, v, motor, v_back)
        assert call(compiled.efforts, s, u, joint, u_back)
        worst, largest = max(worst, abs(u @ motor - joint @ v)), max(largest, abs(u @ motor))
        np.testing.assert_allclose(v_back, v, atol=1e-12)
        np.testing.assert_allclose(u_back, u, atol=1e-12)
    assert largest > 1
    assert worst < 1e-12 * largest


@needs_gxx
def test_motor_positions_lead_back_to_joint_positions(table, compiled):
    for s, motor in zip(POINTS, table.at("motor_position", POINTS), strict=True):
        back = np.clip(s + 0.05, [-0.7, -0.35], [0.5, 0.35])
        assert call(compiled.positions, motor, back)
        np.testing.assert_allclose(back, s, atol=1e-8)


@needs_gxx
def test_off_the_map_nothing_is_carried(compiled):
    found, G = np.empty(2), np.empty(4)
    for s in ([0.6, 0.0], [0.0, -0.4], [np.nan, 0.0]):
        assert not call(compiled.map_at, np.array(s), found, G)
    assert not call(compiled.positions, np.array([9.0, 9.0]), np.zeros(2))


@needs_gxx
def test_a_header_of_more_motors_than_joints_compiles_without_the_way_back(tmp_path):
    text = parallel_ankle.ankle_text().replace("</actuator>", '<motor name="third" joint="ankle_pitch"/></actuator>')
    header = cpp_header(linkplan.transfer(linkplan.load_mechanism(text), ANKLE, tolerance=0.1).found)
    assert "kMotors = 3" in header
    assert "motor_to_joint_velocity" not in header
    (tmp_path / "transmission.hpp").write_text(header)
    (tmp_path / "t.cpp").write_text(
        '#include "transmission.hpp"\nint main() { linkage_ankle_pitch_ankle_roll::Transmission t; (void)t; }\n'
    )
    subprocess.run(["g++", "-std=c++17", "-Wall", "-Werror", str(tmp_path / "t.cpp"), "-o", str(tmp_path / "t")], check=True)
