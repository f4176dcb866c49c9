"""The reduced dynamics: elimination of dependent joints, regular inertia, sizes of expressions."""

from dataclasses import fields

import casadi as ca
import numpy as np
import pytest

from linkplan.models.coordinate_choice import is_regular, without_inertia
from linkplan.models.errors import InertiaError
from linkplan.models.mechanism import load_mechanism
from linkplan.models.reduction.elimination import block_determinants, determinant, factorise, solve_positive
from linkplan.models.reduction.reduced import acceleration_at
from tests.support.mechanisms import SIX_BAR, replaced
from tests.support.tolerances_planner import ROUNDING

SOLVED = 1e-12  # relative to the condition number: rounding


def structured(n: int, density: float, seed: int) -> tuple[ca.SX, np.ndarray]:
    """Return a symbol's entries on a random structure that is not singular as such, and which they are."""
    rng = np.random.default_rng(seed)
    there = rng.random((n, n)) < density
    there |= np.eye(n, dtype=bool)[rng.permutation(n)]
    symbol, matrix = ca.SX.sym("a", n, n), ca.SX(n, n)
    for i, j in zip(*np.nonzero(there), strict=True):
        matrix[int(i), int(j)] = symbol[int(i), int(j)]
    return ca.vertcat(ca.vec(symbol), ca.vec(matrix)), there


@pytest.mark.slow
@pytest.mark.parametrize("n", [1, 2, 3, 4, 6, 9])
@pytest.mark.parametrize("density", [0.0, 0.3, 0.6, 1.0])
def test_a_linear_system_of_any_structure_is_solved_as_numpy_does(n, density):
    for seed in range(4):
        both, there = structured(n, density, seed)
        symbol, matrix = ca.reshape(both[: n * n], n, n), ca.reshape(both[n * n :], n, n)
        b = ca.SX.sym("b", n, 2)
        function = ca.Function("f", [symbol, b], [factorise(matrix)(b), determinant(matrix), block_determinants(matrix)])
        rng = np.random.default_rng(seed)
        numbers, right = rng.normal(size=(n, n)), rng.normal(size=(n, 2))
        x, det, dets = (np.array(v) for v in function(numbers, right))
        A = numbers * there
        assert np.abs(A @ x - right).max() < SOLVED * np.linalg.cond(A)
        assert abs(det[0, 0] / np.linalg.det(A) - 1) < SOLVED * np.linalg.cond(A)
        assert abs(np.prod(np.abs(dets)) / abs(np.linalg.det(A)) - 1) < SOLVED * np.linalg.cond(A)


@pytest.mark.parametrize("n", [12, 13, 20])
def test_the_determinant_of_a_large_block_has_numpy_s_sign_and_size_in_a_bounded_number_of_operations(n):
    symbol, rng = ca.SX.sym("a", n, n), np.random.default_rng(n)
    function = ca.Function("f", [symbol], [determinant(symbol)])
    assert function.n_instructions() < 100_000
    for _ in range(4):
        A = rng.normal(size=(n, n))
        A[rng.permutation(n)[:3], :2] = 0.0  # entries that vanish at one pose only
        assert abs(float(function(A)) / np.linalg.det(A) - 1) < SOLVED * np.linalg.cond(A)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_an_inertia_is_inverted_as_numpy_does(n):
    symbol, b = ca.SX.sym("a", n, n), ca.SX.sym("b", n)
    function = ca.Function("f", [symbol, b], [solve_positive(symbol, b)])
    rng = np.random.default_rng(n)
    half, right = rng.normal(size=(n, n)), rng.normal(size=n)
    A = half @ half.T + 0.1 * np.eye(n)
    assert np.abs(A @ np.array(function(A, right)).ravel() - right).max() < SOLVED * np.linalg.cond(A)


def test_normal_equations_are_solved_to_their_condition_number():
    """An overconstrained loop is closed by them: with the square of that number, the solver of a plan sees 1e-8 of noise."""
    rng = np.random.default_rng(0)
    loop = rng.normal(size=(10, 5)) @ np.diag([1.0, 1.0, 0.1, 0.03, 0.01])
    A, exact, b = loop.T @ loop, rng.normal(size=5), ca.SX.sym("b", 5)
    symbol = ca.SX.sym("a", 5, 5)
    solution = np.array(ca.Function("f", [symbol, b], [factorise(symbol)(b)])(A, A @ exact)).ravel()
    assert np.abs(solution - exact).max() < 10 * np.finfo(float).eps * np.linalg.cond(A)


def test_an_inertia_whose_terms_cancel_on_one_side_of_the_diagonal_alone_is_inverted():
    symbol, b = ca.SX.sym("a", 5, 5), ca.SX.sym("b", 5)
    lopsided = ca.SX(symbol)
    lopsided[0, 4], lopsided[4, 0] = 0, symbol[4, 0] - symbol[0, 4]  # which for a symmetric matrix vanishes
    function = ca.Function("f", [symbol, b], [solve_positive(lopsided, b)])
    A, right = 4.0 * np.eye(5) + np.ones((5, 5)), np.arange(1.0, 6.0)
    exact = A.copy()
    exact[0, 4] = exact[4, 0] = 0.0
    assert np.abs(exact @ np.array(function(A, right)).ravel() - right).max() < SOLVED * np.linalg.cond(exact)


def test_a_matrix_that_no_fixed_order_of_pivots_solves_is_solved():
    angle, b = ca.SX.sym("angle"), ca.SX.sym("b", 4)
    turn = ca.SX(ca.DM(np.eye(4)))
    turn[:2, :2] = turn[2:, 2:] = ca.vertcat(
        ca.horzcat(ca.cos(angle), -ca.sin(angle)), ca.horzcat(ca.sin(angle), ca.cos(angle))
    )
    mixed = turn @ ca.DM(np.linalg.qr(np.random.default_rng(0).normal(size=(4, 4)))[0])
    function = ca.Function("f", [angle, b], [factorise(mixed)(b)])
    for at in np.linspace(0, 2 * np.pi, 9):
        assert abs(np.linalg.norm(np.array(function(at, [1.0, 2, 3, 4]))) - np.sqrt(30)) < ROUNDING


def ladder(n_loops: int) -> str:
    """Return four-bars in a row, each rocker the crank of the next."""
    text = SIX_BAR
    for k in range(2, n_loops):
        last = (
            '<site name="E2" pos="0.01 0 0.17"/></body>\n  </worldbody>'
            if k == 2
            else f'<site name="e{k - 1}" pos="0.01 0 0.17"/></body>\n  </worldbody>'
        )
        link = (
            f'<body pos="0.05 0 0.12"><joint name="L{k}"/><geom type="capsule" fromto="0 0 0 0.16 0 0.05"/>'
            f'<site name="l{k}" pos="0.16 0 0.05"/></body></body>'
            f'<body pos="{0.2 * (k + 1)} 0 0"><joint name="R{k}"/><geom type="capsule" fromto="0 0 0 0.01 0 0.17"/>'
            f'<site name="e{k}" pos="0.01 0 0.17"/></body>\n  </worldbody>'
        )
        text = replaced(text, last, last.replace("</body>\n  </worldbody>", link))
        text = replaced(text, "</equality>", f'<connect site1="l{k}" site2="e{k}"/></equality>')
    return text


def test_expressions_grow_no_faster_than_the_loops():
    sizes = []
    for n_loops in (2, 4, 8):
        mechanism = load_mechanism(ladder(n_loops))
        assert (mechanism.dof, len(mechanism.dependent)) == (1, 2 * n_loops)
        sizes.append(mechanism.dynamics.acceleration.n_instructions())
    assert sizes[2] - sizes[1] < 1.1 * 2 * (sizes[1] - sizes[0])


def loops_that_share_joints(n_loops: int) -> ca.SX:
    """Return a matrix of loops of four rows, each with three columns of its own and all with `n_loops` shared ones."""
    there = np.zeros((4 * n_loops, 4 * n_loops), dtype=bool)
    there[:, :n_loops] = True
    for loop in range(n_loops):
        there[4 * loop : 4 * loop + 4, n_loops + 3 * loop : n_loops + 3 * loop + 3] = True
    symbol, matrix = ca.SX.sym("a", *there.shape), ca.SX(*there.shape)
    for i, j in zip(*np.nonzero(there), strict=True):
        matrix[int(i), int(j)] = symbol[int(i), int(j)]
    return matrix


def operations(*outputs: ca.SX) -> int:
    return ca.Function("f", ca.symvar(ca.veccat(*outputs)), list(outputs)).n_instructions()


def test_loops_that_share_joints_are_solved_in_as_few_operations_in_any_order_of_joints():
    matrix, right = loops_that_share_joints(4), ca.SX.sym("b", 16)
    joints = np.random.default_rng(0).permutation(16).tolist()
    asked, best = (operations(factorise(matrix[:, order])(right)) for order in (joints, [*range(4, 16), *range(4)]))
    assert asked < 1.1 * best


def test_the_determinant_of_loops_in_a_mixed_order_takes_as_few_operations():
    matrix = loops_that_share_joints(4)
    rows = np.random.default_rng(0).permutation(16).tolist()
    numbers = np.random.default_rng(1).normal(size=(16, 16))
    mixed, given = matrix[rows, :], ca.symvar(matrix)
    function = ca.Function("f", given, [determinant(mixed)])
    exact = ca.Function("g", given, [mixed])(*numbers.ravel()[: len(given)])
    assert function(*numbers.ravel()[: len(given)]) == pytest.approx(np.linalg.det(np.array(exact)), rel=1e-9)
    assert operations(determinant(mixed)) < 1.1 * operations(determinant(matrix))


BOX = '<geom type="box" size="0.1 0.2 0.3" contype="0" conaffinity="0"/>'


def with_joints(*joints: str) -> str:
    """Return a model of one body on joints."""
    return f"<mujoco><worldbody><body>{''.join(f'<joint {joint}/>' for joint in joints)}{BOX}</body></worldbody></mujoco>"


SINGULAR = {
    "two hinges on one axis": (['name="a" axis="0 1 0"', 'name="b" axis="0 1 0"'], "joints a and b move together"),
    "parallel slides": (['name="a" type="slide" axis="1 0 0"', 'name="b" type="slide" axis="1 0 0"'], "joints a and b move"),
    "three slides in a plane": (
        ['name="a" type="slide" axis="1 0 0"', 'name="b" type="slide" axis="0 1 0"', 'name="c" type="slide" axis="1 1 0"'],
        "joints a, b and c move together",
    ),
    "gimbal lock": (
        ['name="a" axis="0 0 1"', 'name="b" axis="0 1 0"', 'name="c" axis="0 0 1"'],
        "joints a and c move together",
    ),
    "four hinges on a body": (
        ['name="a" axis="1 0 0"', 'name="b" axis="0 1 0"', 'name="c" axis="0 0 1"', 'name="d" axis="1 1 1"'],
        "joints a, b, c and d move together",
    ),
}


@pytest.mark.filterwarnings("ignore:.*too close to singular")
@pytest.mark.parametrize(("joints", "said"), SINGULAR.values(), ids=SINGULAR)
def test_joints_that_move_no_mass_together_are_refused_by_name_and_pose(joints, said):
    with pytest.raises(InertiaError, match=said) as refused:
        load_mechanism(with_joints(*joints))
    assert "singular inertia at home (a = 0 " in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_armature_makes_two_hinges_on_one_axis_a_mechanism():
    found = load_mechanism(with_joints('name="a" axis="0 1 0"', 'name="b" axis="0 1 0" armature="0.01"'))
    assert is_regular(np.array(found.dynamics.reduced_inertia(found.home)))


def test_small_inertias_are_regular_and_cancelling_ones_are_not():
    assert is_regular(np.diag([1e-12, 1.0, 1e6]))
    assert not is_regular(np.array([[1.0, 1e-6], [1e-6, 1e-12]]))
    assert is_regular(np.array([np.eye(2), np.ones((2, 2)), np.full((2, 2), np.nan)])).tolist() == [True, False, False]
    assert without_inertia(np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 1.0]])) == [0, 2]
    assert without_inertia(np.diag([1.0, 0.0, 1.0])) == [1]


def chain(n: int) -> str:
    opened = "".join(
        f'<body pos="0.1 0 0"><joint name="j{k}" axis="0 {1 - k % 2} {k % 2}"/><geom size="0.01" pos="0.05 0 0"/>'
        for k in range(n)
    )
    return f"<mujoco><worldbody>{opened}{'</body>' * n}</worldbody><actuator><motor joint='j0'/></actuator></mujoco>"


def test_twice_the_freedoms_have_at_most_four_times_the_instructions():
    """The symbolic solution of M a = b has eight times as many."""
    totals = []
    for n in (20, 40):
        dynamics = load_mechanism(chain(n)).dynamics
        built = [getattr(dynamics, field.name) for field in fields(dynamics)]
        totals.append(sum(one.n_instructions() for one in built if isinstance(one, ca.Function)))
    assert totals[0] > 10_000
    assert totals[1] < 4.5 * totals[0], totals


def test_the_acceleration_in_numbers_is_that_of_the_expressions():
    mechanism = load_mechanism("five-bar")
    random = np.random.default_rng(2)
    v, u = random.normal(size=mechanism.dof), random.normal(size=mechanism.n_u)
    exact = np.array(mechanism.dynamics.acceleration(mechanism.home, v, u)).ravel()
    np.testing.assert_allclose(acceleration_at(mechanism.dynamics, mechanism.home, v, u), exact, rtol=1e-10)
