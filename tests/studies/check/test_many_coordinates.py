"""The report on a mechanism of many coordinates: each with its own quantities, in a length that is read."""

import tracemalloc

import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.reach import reach
from linkplan.studies.check.drives import _krylov_space
from linkplan.studies.check.kinematic_loop_report import measured, reach_sweeps
from linkplan.studies.check.whole_check import check_whole
from linkplan.studies.output.text import text_of


def chain(n):
    joints = range(n)
    opened = "".join(
        f"<body name='b{i}' pos='0 0 -0.2'><joint name='j{i}' axis='{1 - i % 2} {i % 2} 0' range='-60 60'/>"
        "<geom type='capsule' fromto='0 0 0 0 0 -0.2' size='0.02' contype='0' conaffinity='0'/>"
        for i in joints
    )
    motors = "".join(f"<motor name='m{i}' joint='j{i}' ctrlrange='-50 50'/>" for i in joints)
    return f"<mujoco><worldbody>{opened}{'</body>' * n}</worldbody><actuator>{motors}</actuator></mujoco>"


@pytest.fixture(scope="module")
def wholes():
    return {n: check_whole(load_mechanism(chain(n)), None) for n in (3, 9)}


def test_of_few_coordinates_all_quantities_are_said(wholes):
    text = text_of(wholes[3].blocks())
    assert text.count("the same at every pose") == 3
    assert "the JSON record has all of them" not in text


def test_of_many_each_has_its_own(wholes):
    text = text_of(wholes[9].blocks())
    assert "the same at every pose" not in text
    assert "for each of the 9 coordinates, the tables above have only its own quantities" in text
    own = next(part for part in text.split("\n\n") if part.startswith("along the reach of j7"))
    head = own.splitlines()[1]
    assert "weight alone j7 [N.m]" in head
    assert "hold m7 [N.m]" in head
    assert "j6" not in head
    assert "m6" not in head


def test_records_of_very_many_coordinates_have_those_of_their_own_only(wholes):
    assert list(measured(wholes[9].sweeps[7]).figures.joint_rate["j0"]) == [f"j{i}" for i in range(9)]
    mechanism = load_mechanism(chain(30))
    (sweep,) = reach_sweeps(mechanism, [reach(mechanism, 7)])
    path = measured(sweep)
    figures = path.figures
    assert figures.coordinate == "j7"
    assert list(figures.joint_rate["j0"]) == list(figures.gravity_effort) == ["j7"]
    np.testing.assert_array_equal(figures.reduced_inertia[:, 0, 0], path.reduced_inertia[:, 7, 7])


def test_a_summary_of_many_coordinates_measures_no_path():
    whole = check_whole(load_mechanism(chain(7)), None)
    assert whole.summary()
    assert "paths" not in vars(whole)
    assert len(list(whole.paths)) == 7


def largest_arrays(work) -> int:
    """Return the most bytes of arrays that are alive at once while `work` runs."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_memory_grows_with_the_square_of_the_coordinates():
    """Twice the coordinates take at most four times the memory; with the cube of them it was eight times."""
    peaks = []
    for n in (24, 48):
        mechanism = load_mechanism(chain(n))
        check_whole(mechanism, None).summary()  # modules and compiled functions are loaded
        reach.cache_clear()
        peaks.append(largest_arrays(lambda of=mechanism: check_whole(of, None).summary()))
    assert peaks[0] > 1e6
    assert peaks[1] < 4.5 * peaks[0], peaks


@pytest.mark.parametrize(("n", "m"), [(6, 1), (6, 2), (7, 3), (5, 5)])
@pytest.mark.parametrize("idle", [0, 2])
def test_the_controllable_space_is_that_of_the_whole_matrix(n, m, idle):
    """The singular values and the projector onto the space are those of [B, A B, ...] in one piece."""
    random = np.random.default_rng(n + 10 * m + 100 * idle)
    A, B = random.normal(size=(n, n)) / n, random.normal(size=(n, m))
    A[n - idle :, : n - idle], B[n - idle :] = 0, 0  # the last coordinates move by themselves
    whole = np.hstack([np.linalg.matrix_power(A, k) @ B for k in range(n)])
    space, sizes = _krylov_space(A, B, 1e-9)
    expected = np.linalg.matrix_rank(whole, tol=1e-9)
    assert np.count_nonzero(sizes > 1e-9) == expected == n - idle
    basis, exact = space[:, sizes > 1e-9], np.linalg.svd(whole)[0][:, :expected]
    np.testing.assert_allclose(basis @ basis.T, exact @ exact.T, atol=1e-9)
