"""Singular poses and where a function changes its sign, against closed forms."""

import math
import warnings

import numpy as np
import pytest

from linkplan.models.errors import UnassembledError
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.models.poses.sign_change import sign_change
from linkplan.models.poses.singular_poses import common_zeros
from linkplan.studies.check.inspection import inspect
from tests.support.mechanisms import replaced, slider_crank
from tests.support.overconstrained import HEAD, bricard, coupled_cranks, sarrus
from tests.support.tolerances import BRANCHING

DRAWN = 0.5


def test_the_flat_pose_of_sarrus_linkage_is_found_though_its_determinant_changes_no_sign():
    mechanism = load_mechanism(sarrus(DRAWN))
    assert (mechanism.dof, len(mechanism.dependent)) == (1, 4)
    can = reach(mechanism)
    flat = [(position, rank) for position, rank in can.branching if can.lower.position < position < can.upper.position]
    assert len(flat) == 1
    assert abs(flat[0][0] + DRAWN) < BRANCHING
    assert flat[0][1] == 2
    assert flat[0][0] in can.singular


def test_check_says_that_the_closure_loses_rank_where_it_does():
    notes = inspect(load_mechanism(sarrus(DRAWN)), []).notes
    assert any("rank falls from 4 to 2" in note for note in notes)
    assert not any("is at a dead centre" in note for note in notes)


def test_a_parallelogram_branches_where_it_lies_flat():
    mechanism = load_mechanism(coupled_cranks(pivots=((0, 0), (0.2, 0)), drawn=DRAWN))
    can = reach(mechanism)
    assert [rank for _, rank in can.branching] == [1, 1]
    assert np.abs(np.array(can.singular) - (np.array([0.0, np.pi]) - np.pi + DRAWN)).max() < BRANCHING


@pytest.mark.parametrize(
    "text",
    [bricard(), replaced(slider_crank(1.0), '<motor joint="crank"', '<motor joint="slide"')],
    ids=["bricard", "slider"],
)
def test_a_dead_centre_of_the_coordinate_is_no_branching_pose(text):
    mechanism = load_mechanism(text)
    can = reach(mechanism)
    assert len(can.singular) == 2
    assert can.branching == ()
    notes = inspect(mechanism, []).notes
    assert sum("is at a dead centre" in note for note in notes) == 2
    assert not any("branch" in note for note in notes)


ROW = ((0, 0), (-0.1, 0), (0.25, 0))  # the middle one is driven


@pytest.mark.parametrize(("pivots", "alone"), [(ROW, True), (ROW[:2], False)])
def test_three_cranks_in_a_row_lose_rank_where_they_lie_flat_and_do_not_branch(pivots, alone):
    mechanism = load_mechanism(coupled_cranks(pivots=pivots, drawn=np.pi / 2))
    can = reach(mechanism)
    assert len(can.branching) == 2
    assert can.single == (can.singular if alone else ())
    notes = inspect(mechanism, []).notes
    assert sum("Only one motion passes this pose" in note for note in notes) == (2 if alone else 0)
    assert sum("may change to another branch" in note for note in notes) == (0 if alone else 2)
    assert other_ways(mechanism) is not alone  # what is said is true


def other_ways(mechanism: Mechanism) -> bool:
    """Return whether closed poses next to the flat one are there in which the cranks do not stand alike."""
    flat, rng = mechanism.home * 0, np.random.default_rng(1)
    cranks = [i for i, joint in enumerate(mechanism.joints) if joint.name.startswith("O")]
    plate = next(i for i in range(mechanism.n_q) if i not in cranks)
    flat[[*cranks, plate]] = [*([np.pi / 2] * len(cranks)), -np.pi / 2]  # drawn upright, a quarter turn on
    assert mechanism.gap_m(flat) < 1e-12
    found = []
    for _ in range(60):
        x = flat + rng.uniform(-0.2, 0.2, mechanism.n_q)
        for _ in range(60):
            phi, J = (np.array(f(x)) for f in (mechanism.dynamics.closure, mechanism.dynamics.closure_jacobian))
            x = x - np.linalg.lstsq(J, phi.ravel(), rcond=1e-9)[0]
        if mechanism.gap_m(x) < 1e-11 and np.abs(x - flat).max() < 0.5:
            found.append(np.ptp(x[cranks]))
    assert len(found) > 10
    return bool(max(found) > 0.02)


ARM = (
    '<body pos="0.6 0 0"><joint name="extra" axis="0 -1 0"/><geom size="0.01" pos="0.1 0 0" mass="0.1"/></body></worldbody>'
)


@pytest.mark.parametrize(("pivots", "alone"), [(ROW, True), (ROW[:2], False)])
def test_a_further_freedom_does_not_hide_whether_one_motion_alone_leads_through(pivots, alone):
    mechanism = load_mechanism(replaced(coupled_cranks(pivots=pivots, drawn=np.pi / 2), "</worldbody>", ARM))
    assert mechanism.dof == 2
    (cranks,) = [can for can in (reach(mechanism, k) for k in (0, 1)) if can.singular]
    assert len(cranks.branching) == 2
    assert cranks.single == (cranks.singular if alone else ())


def symmetric(rng: np.random.Generator, n: int) -> np.ndarray:
    return (lambda A: A + A.T)(rng.normal(size=(n, n)))


def test_quadratic_forms_that_vanish_on_one_space_alone_are_told_from_those_that_do_not():
    rng = np.random.default_rng(0)
    for n in (3, 4, 5):
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        square, after = np.zeros((n, n)), np.zeros((n, n))
        square[0, 0], after[0, 1], after[1, 0], after[1, 1] = 1.0, 3.0, 3.0, 1.0  # x0 = 0, and then x1 = 0
        mixed = turn @ np.array([square - 2 * after, after + square]) @ turn.T
        zeros = common_zeros(mixed)
        assert zeros is not None
        assert zeros.shape == (n, n - 2)
        assert np.abs(turn[:, :2].T @ zeros).max() < 1e-3
        crossing = np.diag([1.0, -1.0, *np.zeros(n - 2)])
        assert common_zeros((turn @ crossing @ turn.T)[None]) is None, "two planes cross"
        cone = np.diag([1.0, 1.0, -1.0, *np.zeros(n - 3)])
        assert common_zeros((turn @ cone @ turn.T)[None]) is None, "a cone"
        one = common_zeros(np.array([np.eye(n) + 0.1 * symmetric(rng, n) / n, symmetric(rng, n)]))
        assert one is not None
        assert one.shape[1] == 0, "nothing but zero"


def double_four_bar(turned: float, driven: str) -> str:
    """Return three equal cranks a crank's length apart, rods between them, at an angle [rad] from lying flat."""
    tip = f"{0.1 * np.cos(turned)} 0 {0.1 * np.sin(turned)}"
    arm = f'<geom type="capsule" fromto="0 0 0 {tip}" mass="0.1"/>'
    rods = "".join(
        f'<body pos="{tip}"><joint name="R{k}" axis="0 -1 0"/><geom type="capsule" fromto="0 0 0 {x} 0 0" mass="0.1"/>'
        f'<site name="e{k}" pos="{x} 0 0"/></body>'
        for k, x in enumerate((-0.1, 0.1))
    )
    others = "".join(
        f'<body pos="{x} 0 0"><joint name="{name}" axis="0 -1 0"/>{arm}<site name="t{k}" pos="{tip}"/></body>'
        for k, (x, name) in enumerate(((0, "left"), (0.2, "right")))
    )
    return (
        f"{HEAD.format(name='double')}<worldbody>"
        f'<body pos="0.1 0 0"><joint name="middle" axis="0 -1 0"/>{arm}{rods}</body>{others}</worldbody>'
        '<equality><connect site1="e0" site2="t0"/><connect site1="e1" site2="t1"/></equality>'
        f'<actuator><motor joint="{driven}" ctrlrange="-2 2"/></actuator></mujoco>'
    )


@pytest.mark.parametrize("driven", ["middle", "left"])
def test_a_double_four_bar_branches_where_it_lies_flat_whichever_crank_drives(driven):
    can = reach(load_mechanism(double_four_bar(np.pi / 2, driven)))
    assert [rank for _, rank in can.branching] == [2, 2]
    assert np.abs(np.array(can.singular) - [-np.pi / 2, np.pi / 2]).max() < BRANCHING
    assert can.single == ()


@pytest.mark.parametrize("driven", ["middle", "left"])
def test_a_double_four_bar_drawn_flat_is_refused_for_its_rank_and_not_as_locked(driven):
    with pytest.raises(UnassembledError, match="rank 2 there and 4 next to it") as refused:
        load_mechanism(double_four_bar(0.0, driven))
    assert "cannot move" not in str(refused.value)


# Ranges

STILL = """<mujoco model="still"><compiler angle="radian"/><worldbody>
  <body name="trunk"><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0 0 0.2"/>
    <body name="head" pos="0 0 0.4"><joint name="neck" axis="0 1 0" range="0 1" limited="true"/>
      <geom size="0.05" pos="0 0 0.1"/></body></body>
  </worldbody>
  <equality><joint joint1="neck" polycoef="{at} 0 0 0 0"/></equality>
  <actuator><motor name="hip" joint="hip" ctrlrange="-9 9"/></actuator>
</mujoco>"""


@pytest.mark.parametrize("at", [0.0, -1e-11, -1e-3])
def test_a_joint_that_does_not_move_with_a_coordinate_does_not_stop_it(at):
    mechanism = load_mechanism(STILL.format(at=at))
    assert abs(mechanism.home[1] - at) < 1e-12
    assert reach(mechanism).turns_fully


SHAPES = {
    "a line": (lambda x: x - 0.3, 0.3),
    "steep": (lambda x: math.expm1(20 * (x - 0.7)), 0.7),
    "flat": (lambda x: (x - 0.4) ** 5, 0.4),
    "falling": (lambda x: math.cos(3 * x), math.pi / 6),
    "a jump": (lambda x: 1.0 if x > 0.123 else -1.0, 0.123),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("backwards", [False, True])
def test_the_place_is_found_to_the_tolerance(shape, backwards):
    function, root = SHAPES[shape]
    ends = (1.0, 0.0) if backwards else (0.0, 1.0)
    assert sign_change(function, *ends, xtol=1e-14) == pytest.approx(root, abs=1e-3 if shape == "flat" else 2e-14)


def test_many_places_are_found_together_and_none_where_the_function_has_no_value():
    roots, asked = np.array([0.1, 0.5, np.nan, 0.9]), []
    found = sign_change(lambda x: asked.append(x) or np.exp(3 * x) - np.exp(3 * roots), np.zeros(4), np.ones(4), xtol=1e-14)
    np.testing.assert_allclose(found, roots, atol=2e-14)
    assert len(asked) < 20


def test_a_function_that_has_been_without_a_value_says_nothing_more():
    def pair(x: np.ndarray) -> np.ndarray:
        gap = np.where(np.abs(x - 0.5) < 0.05, np.nan, np.where(x > 0.5, 1.0, -0.01 - (x - 0.2) ** 2))
        return np.array([gap[0], np.expm1(20 * (x[1] - 0.7))])

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = sign_change(pair, np.zeros(2), np.ones(2), xtol=1e-14)
    np.testing.assert_allclose(found, [np.nan, 0.7], atol=2e-14)
