"""The Optimus knee against closed forms that were worked out apart from this project (tests/data/knee.json)."""

from functools import cache

import numpy as np
import pytest

from linkplan.models.closure.newton import CLOSED_M
from linkplan.models.errors import AssemblyError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.payload import SHANK
from linkplan.models.poses.along import needed_effort
from linkplan.models.poses.assembly import close_at, follow
from linkplan.models.poses.contacts import contact_pairs
from linkplan.models.poses.reach import Reach, reach, toggles
from linkplan.models.poses.skeleton import sticks
from tests.support.data import KNEE_TABLE as REFERENCE
from tests.support.mechanisms import FourBar, stated_gap_mm
from tests.support.tolerances import (
    ANGLE_RAD,
    BRACKET_RAD,
    KNEE,
    LEAST_GAP,
    MISSED_NM,
    ROOT_ORDER,
    SAMPLED_PEAK,
    SINGULAR_RAD,
    relative_error,
)

CONFIGURATIONS = REFERENCE["configurations"]
GRAVITY = 9.81
BAR = FourBar(crank=0.057, coupler=0.0741, rocker=0.0855, ground=0.057, branch=1, drawn=0.0)

both_models = pytest.mark.parametrize("name", ["optimus-knee", "optimus-knee-source"])
at_every_configuration = pytest.mark.parametrize("row", CONFIGURATIONS, ids=lambda row: f"O={row['q_O_deg']}")


@cache
def knee(name: str = "optimus-knee", payload: str | None = None) -> Mechanism:
    return load_mechanism(name, payload=payload)


@cache
def knee_reach(name: str) -> Reach:
    return reach(knee(name))


def pose(mechanism: Mechanism, q_O_deg: float) -> np.ndarray:
    """Return the pose at q_O on the home branch; joint D, which the source's knee has beside, stays at zero."""
    return close_at(mechanism, np.array([np.radians(q_O_deg), 0.0])[: mechanism.dof])


@both_models
@at_every_configuration
def test_angles_rates_inertia_and_weight_are_the_closed_forms(name, row):
    dynamics, q = knee(name).dynamics, pose(knee(name), row["q_O_deg"])
    assert np.abs(q[:3] - np.radians([row["q_O_deg"], row["q_A_deg"], row["q_C_deg"]])).max() < ANGLE_RAD
    rates = np.array(dynamics.velocity_map(q))[:3, 0]
    assert relative_error(rates, [1.0, row["dqA_dqO"], row["dqC_dqO"]]) < KNEE
    assert relative_error(np.array(dynamics.reduced_inertia(q))[0, 0], row["reduced_inertia_kgm2"]) < KNEE
    assert relative_error(np.array(dynamics.gravity_effort(q))[0, 0], row["gravity_torque_Nm"]) < KNEE


def test_home_is_the_drawn_pose_with_the_crank_upright():
    row = next(row for row in CONFIGURATIONS if row["q_O_deg"] == 0)
    assert np.abs(knee().home - np.radians([0.0, row["q_A_deg"], row["q_C_deg"]])).max() < ANGLE_RAD


def test_the_sources_drawn_pose_stands_open_by_73_mm():
    crank, coupler, rocker, ground = 0.057, 0.0741, 0.0855, 0.057
    gap = np.hypot(ground, crank + coupler - rocker)
    assert gap > 0.07
    assert relative_error(knee("optimus-knee-source").home_gap_m, gap) < KNEE


@pytest.mark.slow
@both_models
def test_the_upper_end_of_the_reach_is_the_singular_pose(name):
    end = knee_reach(name).upper
    assert end.reason == "singular pose"
    assert abs(end.position - np.radians(REFERENCE["singular_q_O_deg"])) < SINGULAR_RAD


@pytest.mark.parametrize(
    ("name", "joint", "position"),
    [("optimus-knee", "O", -np.pi / 2), ("optimus-knee-source", "A", np.radians(REFERENCE["q_A_90deg_at_q_O_deg"]))],
)
def test_the_lower_end_of_the_reach_is_the_range_of_the_motor_or_of_joint_a(name, joint, position):
    end = knee_reach(name).lower
    assert (end.reason, end.joint) == (f"range of {joint}", "OA".index(joint))
    assert abs(end.position - position) < BRACKET_RAD


@both_models
def test_joint_c_turns_back_at_the_toggle(name):
    ((joint, position),) = toggles(knee(name))
    assert knee(name).joints[joint].name == "C"
    assert abs(position - np.radians(REFERENCE["toggle_q_A_zero_q_O_deg"])) < BRACKET_RAD


@at_every_configuration
def test_the_determinant_of_the_dependent_joints_is_the_area_that_coupler_and_rocker_span(row):
    area = BAR.coupler * BAR.rocker * BAR.transmission(np.radians(row["q_O_deg"]))
    determinant = float(knee().dynamics.block_singularity(pose(knee(), row["q_O_deg"])))
    assert relative_error(abs(determinant), area) < KNEE


def test_the_determinant_vanishes_with_the_root_of_the_distance_to_the_singular_pose():
    distance_deg = np.array([1e-2, 1e-3, 1e-4])
    poses = [pose(knee(), REFERENCE["singular_q_O_deg"] - d) for d in distance_deg]
    determinant = np.array([abs(float(knee().dynamics.block_singularity(q))) for q in poses])
    order = np.diff(np.log(determinant)) / np.diff(np.log(distance_deg))
    assert np.abs(order - 0.5).max() < ROOT_ORDER


def test_home_by_a_dependent_joint_alone_holds_that_joint():
    home = load_mechanism("optimus-knee", home={"A": 1.0}).home
    assert home[1] == 1.0
    assert knee().gap_m(home) < 10 * CLOSED_M


@pytest.mark.slow
@pytest.mark.parametrize("asked_deg", [79.0, 82.0, 85.0])
def test_a_home_out_of_reach_is_refused_with_the_gap_that_stays_open_there(asked_deg):
    shortfall = (BAR.rocker - BAR.coupler) - BAR.diagonal(np.radians(asked_deg))
    assert shortfall > 0, "coupler and rocker cannot meet"
    with pytest.raises(AssemblyError, match=f"O = {asked_deg:g} deg") as refused:
        load_mechanism("optimus-knee", home={"O": np.radians(asked_deg)})
    assert relative_error(stated_gap_mm(refused.value), 1e3 * shortfall) < LEAST_GAP


def test_a_home_far_from_any_branch_is_refused():
    with pytest.raises(AssemblyError, match=r"O = 0 deg, A = -85"):
        load_mechanism("optimus-knee", home={"O": 0.0, "A": np.radians(-85.0)})


@cache
def sine(payload: str | None) -> np.ndarray:
    """Return the torque [N.m] of the document's sinusoid, 3.6 deg + 52.67 deg sin(2 pi 4 Hz t), at 4001 instants."""
    mechanism = knee(payload=payload)
    rate, amplitude = 2 * np.pi * 4, np.radians(52.67)
    t = np.linspace(0, 0.25, 4001)[:, None]
    s = np.radians(3.6) + amplitude * np.sin(rate * t)
    v, a = amplitude * rate * np.cos(rate * t), -amplitude * rate**2 * np.sin(rate * t)
    effort, missed = needed_effort(mechanism, follow(mechanism, s), v, a)
    assert not np.any(np.abs(missed) > MISSED_NM), "one motor is enough for one degree of freedom"
    return effort[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize("payload", [None, "shank"])
def test_torque_of_the_documents_sinusoid_has_the_known_extremes(payload):
    expected = REFERENCE["seed_sine"][payload or "unloaded"]
    effort = sine(payload)
    assert relative_error([effort.min(), effort.max()], [expected["min_Nm"], expected["max_Nm"]]) < SAMPLED_PEAK


@at_every_configuration
def test_the_shank_adds_its_weight_times_its_lever(row):
    bare, loaded = knee(), knee(payload="shank")
    shank, q = REFERENCE["shank"], pose(knee(), row["q_O_deg"])
    added = float(loaded.dynamics.gravity_effort(q)) - float(bare.dynamics.gravity_effort(q))
    # The shank points along -x at 56.27 deg; turning about +y takes -x to +z.
    lever = shank["com_distance_m"] * np.cos(np.radians(row["q_O_deg"] - 56.27))
    assert relative_error(added, shank["mass_kg"] * GRAVITY * lever) < KNEE


def test_a_scaled_payload_scales_what_it_adds():
    q = pose(knee(), 20.0)
    added = [
        float(load_mechanism("optimus-knee", payload=p).dynamics.reduced_inertia(q))
        - float(knee().dynamics.reduced_inertia(q))
        for p in (SHANK, SHANK.scaled(2.5))
    ]
    assert relative_error(added[1], 2.5 * added[0]) < KNEE


@pytest.mark.parametrize(("inertia", "own"), [({"inertia_kgm2": [0.02, 0.03, 0.04]}, 0.03), ({}, 0.0)])
def test_a_payload_given_as_a_table_is_the_payload_and_a_point_mass_needs_no_inertia(inertia, own):
    table = {"body": "crank", "mass_kg": 2, "com_m": [0.0, 0.0, -0.1]} | inertia
    q = pose(knee(), 20.0)
    loaded = load_mechanism("optimus-knee", payload=table)
    added = float(loaded.dynamics.reduced_inertia(q)) - float(knee().dynamics.reduced_inertia(q))
    assert relative_error(added, own + 2 * 0.1**2) < KNEE


def test_the_payload_named_none_is_no_payload():
    q = knee().home
    none = load_mechanism("optimus-knee", payload="none")
    assert none.payload is None
    assert float(none.dynamics.reduced_inertia(q)) == float(knee().dynamics.reduced_inertia(q))


def touching(name: str) -> set[frozenset[str]]:
    poses = knee_reach(name).poses[::5]
    pairs = contact_pairs(knee(name), poses)
    return {frozenset(pair.geoms) for pair in pairs if len(pair.poses) == len(poses)}


def test_the_sources_coupler_and_ball_b_touch_at_every_pose():
    assert frozenset(("L2", "B")) in touching("optimus-knee-source")


def test_no_links_of_the_knee_touch_anywhere():
    assert contact_pairs(knee(), knee_reach("optimus-knee").poses[::5]) == ()


def test_sticks_are_as_long_as_the_links_at_every_pose():
    drawn = {stick.body: stick.pins for stick in sticks(knee(), knee_reach("optimus-knee").poses[::5])}
    lengths = {"ground": BAR.ground, "crank": BAR.crank, "coupler": BAR.coupler, "rocker": BAR.rocker}
    assert set(drawn) == set(lengths)
    for body, pins in drawn.items():
        assert relative_error(np.linalg.norm(pins[:, 1] - pins[:, 0], axis=1), np.full(len(pins), lengths[body])) < KNEE


def test_sticks_show_the_crank_upright_at_home_seen_with_x_to_the_right():
    (crank,) = (stick for stick in sticks(knee(), knee().home[None]) if stick.body == "crank")
    assert np.abs(crank.pins[0] - [[0.0, 0.5], [0.0, 0.5 + BAR.crank]]).max() < KNEE
