"""Andrews' squeezing mechanism against the IVP test set: its mass matrix, its loops, its spring, its motion to t = 0.03 s.

tests/data/andrews.json holds the test set's constants, equations and results (Hairer & Wanner, Solving ODEs II, VI.7).
"""

import json
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.assembly import close_at
from linkplan.models.poses.reach import reach
from tests.support.data import DATA
from tests.support.mechanism_checks import acceleration, mechanism_of
from tests.support.tolerances import CLOSURE, ENERGY, INTEGRATED_GAP, POWER, START_POSE, TREE, relative_error

NAME, PROBLEM = "andrews-squeezer", "squeezer-turn"
TABLE = json.loads((DATA / "andrews.json").read_text(encoding="utf-8"))
LENGTH, MASS, MOMENT, POINT = TABLE["lengths"], TABLE["mass"], TABLE["inertia_com"], TABLE["fixed_points"]
ANGLES = ("beta", "Theta", "gamma", "Phi", "delta", "Omega", "epsilon")
# The test set's own result is good to about 1e-9 at t = 0.03 s; the reduced model is integrated to 1e-11.
BETA = 1e-8
# The test set states beta''(0) to twelve digits.
START_ACCELERATION = 1e-11


def angles(mechanism: Mechanism, q: np.ndarray) -> dict[str, float]:
    """Return the test set's angles of a pose by name."""
    return {joint.name: float(x) for joint, x in zip(mechanism.joints, q, strict=True)}


def loop_equations(a: dict[str, float]) -> np.ndarray:
    """Return the test set's six loop equations (6,) [m]."""
    c, s, d = np.cos, np.sin, LENGTH
    beta, Theta, gamma, Phi, delta, Omega, epsilon = (a[name] for name in ANGLES)
    x = d["rr"] * c(beta) - d["d"] * c(beta + Theta)
    y = d["rr"] * s(beta) - d["d"] * s(beta + Theta)
    xa, ya, xb, yb = *POINT["A"], *POINT["B"]
    return np.array(
        [
            x - d["ss"] * s(gamma) - xb,
            y + d["ss"] * c(gamma) - yb,
            x - d["e"] * s(Phi + delta) - d["zt"] * c(delta) - xa,
            y + d["e"] * c(Phi + delta) - d["zt"] * s(delta) - ya,
            x - d["zf"] * c(Omega + epsilon) - d["u"] * s(epsilon) - xa,
            y - d["zf"] * s(Omega + epsilon) + d["u"] * c(epsilon) - ya,
        ]
    )


def mass_matrix(a: dict[str, float]) -> np.ndarray:
    """Return the test set's mass matrix (7, 7) in the order of ANGLES."""
    d, m, i = LENGTH, MASS, MOMENT
    M = np.zeros((7, 7))
    cos_Theta, sin_Phi, sin_Omega = np.cos(a["Theta"]), np.sin(a["Phi"]), np.sin(a["Omega"])
    near4, near6 = d["e"] - d["ea"], d["zf"] - d["fa"]
    M[0, 0] = m["K1"] * d["ra"] ** 2 + m["K2"] * (d["rr"] ** 2 - 2 * d["da"] * d["rr"] * cos_Theta + d["da"] ** 2)
    M[0, 0] += i["K1"] + i["K2"]
    M[1, 0] = M[0, 1] = m["K2"] * (d["da"] ** 2 - d["da"] * d["rr"] * cos_Theta) + i["K2"]
    M[1, 1] = m["K2"] * d["da"] ** 2 + i["K2"]
    M[2, 2] = m["K3"] * (d["sa"] ** 2 + d["sb"] ** 2) + i["K3"]
    M[3, 3] = m["K4"] * near4**2 + i["K4"]
    M[4, 3] = M[3, 4] = m["K4"] * (near4**2 + d["zt"] * near4 * sin_Phi) + i["K4"]
    M[4, 4] = m["K4"] * (d["zt"] ** 2 + 2 * d["zt"] * near4 * sin_Phi + near4**2)
    M[4, 4] += m["K5"] * (d["ta"] ** 2 + d["tb"] ** 2) + i["K4"] + i["K5"]
    M[5, 5] = m["K6"] * near6**2 + i["K6"]
    M[6, 5] = M[5, 6] = m["K6"] * (near6**2 - d["u"] * near6 * sin_Omega) + i["K6"]
    M[6, 6] = m["K6"] * (near6**2 - 2 * d["u"] * near6 * sin_Omega + d["u"] ** 2)
    M[6, 6] += m["K7"] * (d["ua"] ** 2 + d["ub"] ** 2) + i["K6"] + i["K7"]
    return M


def spring(gamma: float) -> tuple[float, float]:
    """Return the spring's length and its torque on K3."""
    sd, sc = LENGTH["sd"], LENGTH["sc"]
    arm = np.array([sd * np.cos(gamma) + sc * np.sin(gamma), sd * np.sin(gamma) - sc * np.cos(gamma)])
    way = np.array(POINT["B"]) + arm - np.array(POINT["C"])
    length = float(np.hypot(*way))
    pull = -TABLE["spring"]["stiffness"] * (length - TABLE["spring"]["rest_length"])
    return length, pull * float(way @ np.array([-arm[1], arm[0]])) / length


def in_table_order(mechanism: Mechanism) -> list[int]:
    return [[joint.name for joint in mechanism.joints].index(name) for name in ANGLES]


def some_poses() -> list[np.ndarray]:
    """Return closed poses all round the crank's turn."""
    mechanism = mechanism_of(NAME)
    return [close_at(mechanism, np.array([beta])) for beta in np.linspace(-0.06, 6.0, 9)]


@cache
def spun_up():
    """Return the motion under the constant torque, all joints integrated: rows of (q, v) at the tabulated times."""
    mechanism, torque = mechanism_of(NAME), np.array([TABLE["torque_K1"]])
    flow, n_q = mechanism.dynamics.flow, mechanism.n_q

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        del t
        return np.concatenate([np.array(part).ravel() for part in flow(x[:n_q], x[n_q:], torque)])

    times = [float(t) for t in TABLE["beta_at"]]
    start = np.append(mechanism.home, 0.0)
    solved = solve_ivp(rate, (0.0, times[-1]), start, method="DOP853", rtol=1e-11, atol=1e-11, t_eval=times)
    assert solved.success
    return solved.y.T


def test_seven_bodies_and_three_loops_on_one_pin_leave_the_crank():
    mechanism = mechanism_of(NAME)
    assert (mechanism.n_q, len(mechanism.closure_names), len(mechanism.closure_rows), mechanism.dof) == (7, 3, 6, 1)
    assert [joint.name for joint in mechanism.independent_joints] == ["beta"]


def test_the_drawn_pose_is_the_test_set_s_start():
    mechanism = mechanism_of(NAME)
    assert mechanism.home_gap_m < CLOSURE
    found = angles(mechanism, mechanism.home)
    assert max(abs(found[name] - TABLE["start"][name]) for name in ANGLES) < START_POSE


def test_closed_poses_satisfy_the_test_set_s_loop_equations():
    for q in some_poses():
        assert np.abs(loop_equations(angles(mechanism_of(NAME), q))).max() < INTEGRATED_GAP


def test_the_tree_s_mass_matrix_is_the_test_set_s():
    mechanism = mechanism_of(NAME)
    order = in_table_order(mechanism)
    for q in some_poses():
        found = np.array(mechanism.dynamics.mass_matrix(q))[np.ix_(order, order)]
        assert relative_error(found, mass_matrix(angles(mechanism, q))) < TREE


@pytest.mark.slow
def test_the_spring_s_torque_on_k3_is_the_test_set_s():
    mechanism = mechanism_of(NAME)
    expected = np.array([spring(angles(mechanism, q)["gamma"])[1] for q in some_poses()])
    assert np.ptp(expected) > 0.1
    found = np.array([np.array(mechanism.dynamics.passive(q, np.zeros(7))).ravel() for q in some_poses()])
    assert relative_error(found[:, 2], expected) < TREE
    assert np.abs(np.delete(found, 2, axis=1)).max() == 0.0


def test_the_crank_starts_with_the_tabulated_acceleration():
    mechanism = mechanism_of(NAME)
    found = acceleration(mechanism, mechanism.home, np.zeros(1), np.array([TABLE["torque_K1"]]))
    assert relative_error(found, [TABLE["start"]["beta_acceleration"]]) < START_ACCELERATION


@pytest.mark.parametrize("row", range(6))
def test_the_crank_stands_where_the_test_set_says(row):
    """beta(0.03) = 15.81077119629904 is asked for within 1e-6; it comes within 2e-9."""
    expected = list(TABLE["beta_at"].values())[row]
    assert abs(spun_up()[row, 0] - expected) < BETA


def test_the_loops_are_still_closed_after_two_and_a_half_turns():
    mechanism = mechanism_of(NAME)
    gap = [np.abs(loop_equations(angles(mechanism, row[:7]))).max() for row in spun_up()]
    assert max(gap) < INTEGRATED_GAP


def test_the_torque_s_work_is_in_the_motion_and_the_spring():
    mechanism = mechanism_of(NAME)
    rest_length, stiffness = TABLE["spring"]["rest_length"], TABLE["spring"]["stiffness"]

    def stored(q: np.ndarray) -> float:
        return 0.5 * stiffness * (spring(angles(mechanism, q)["gamma"])[0] - rest_length) ** 2

    for row in spun_up():
        q, rates = row[:7], np.array(mechanism.dynamics.velocity_map(row[:7])) @ row[7:]
        order = in_table_order(mechanism)
        moving = 0.5 * rates[order] @ mass_matrix(angles(mechanism, q)) @ rates[order]
        work = TABLE["torque_K1"] * (q[0] - mechanism.home[0])
        assert work == pytest.approx(moving + stored(q) - stored(mechanism.home), rel=POWER, abs=ENERGY)


def test_the_crank_turns_fully():
    can = reach(mechanism_of(NAME))
    assert can.turns_fully
    assert can.singular == ()
