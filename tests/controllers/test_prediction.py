"""The quadratic program of a predicted motion against stacked matrices, exponentials and predictions written out."""

import numpy as np
import pytest
import scipy.linalg

from linkplan.controllers.linearisation import linearise
from linkplan.controllers.trackers.prediction import condensing, predictor
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import close_at


def stacked_program(A, B, e, w, Q, R, P) -> tuple[np.ndarray, np.ndarray]:
    """Return the Hessian and gradient of half of sum (e + dx)' Q (e + dx) + (w + d)' R (w + d) by one matrix for all dx."""
    blocks, m, n_u = len(A), A[0].shape[0], B[0].shape[1]
    way = np.zeros((blocks * m, blocks * n_u))
    for b in range(blocks):
        effect = B[b]
        for later in range(b, blocks):
            way[later * m : (later + 1) * m, b * n_u : (b + 1) * n_u] = effect
            effect = A[later + 1] @ effect if later + 1 < blocks else effect
    weight = scipy.linalg.block_diag(*[Q] * (blocks - 1), P)
    costs = np.kron(np.eye(blocks), R)
    return way.T @ weight @ way + costs, way.T @ weight @ e.T.ravel() + costs @ w.T.ravel()


@pytest.mark.parametrize(("blocks", "m", "n_u"), [(1, 2, 1), (3, 2, 1), (4, 3, 2)])
def test_the_condensed_program_is_that_of_stacked_matrices(blocks, m, n_u):
    draw = np.random.default_rng(blocks)
    A, B = draw.normal(size=(blocks, m, m)), draw.normal(size=(blocks, m, n_u))
    e, w = draw.normal(size=(m, blocks)), draw.normal(size=(n_u, blocks))
    Q, R, P = (x @ x.T for x in (draw.normal(size=(m, m)), draw.normal(size=(n_u, n_u)), draw.normal(size=(m, m))))
    hessian, gradient = condensing(blocks, m, n_u)(np.hstack(list(A)), np.hstack(list(B)), e, w, Q, R, P)
    expected = stacked_program(A, B, e, w, Q, R, P)
    assert np.array(hessian) == pytest.approx(expected[0], rel=1e-10, abs=1e-10)
    assert np.array(gradient).ravel() == pytest.approx(expected[1], rel=1e-10, abs=1e-10)


def test_a_prediction_is_along_the_corrected_motion_from_the_measured_state():
    """Two blocks: the error after each is the corrected step less the reference's, the slopes are half-way along it."""
    mechanism, block_s, kept = load_mechanism("optimus-knee"), 2e-3, np.array([0, 1])
    near = mechanism.home
    model = predictor(mechanism, kept, 2, block_s, "never")
    s, v = near[mechanism.independent] + 0.02, np.array([1.5])
    means, corrections = np.array([[3.0, -4.0]]), np.array([[30.0, -60.0]])
    begins = [np.append(near, 0.5)]
    begins.append(np.array(model.step(begins[0], means[:, 0])).ravel())
    owns = [begins[1], np.array(model.step(begins[1], means[:, 1])).ravel()]
    Q, R, P = np.diag([2.0, 0.5]), np.array([[0.3]]), np.diag([5.0, 1.0])
    hessian, gradient, gap = model.program(near, s, v, np.array(begins).T, means, np.array(owns).T, corrections, Q, R, P)
    assert float(gap) < 1e-9
    x, errors, A, B = np.append(close_at(mechanism, s, near), v), [], [], []
    for b in range(2):
        effort = means[:, b] + corrections[:, b]
        after = np.array(model.step(x, effort)).ravel()
        half = 0.5 * (x + after)
        block = np.zeros((3, 3))
        of_state, of_effort = linearise(mechanism, half[None, :-1], half[None, -1:], effort[None])
        block[:2, :2], block[:2, 2:] = of_state[0], of_effort[0]
        exponential = scipy.linalg.expm(block_s * block)
        A.append(exponential[:2, :2])
        B.append(exponential[:2, 2:])
        error = after - owns[b]
        errors.append([error[mechanism.independent[0]], error[-1]])
        x = begins[b + 1] + error if b == 0 else after
    expected = stacked_program(A, B, np.array(errors).T, corrections, Q, R, P)
    assert np.array(hessian) == pytest.approx(expected[0], rel=1e-7)
    assert np.array(gradient).ravel() == pytest.approx(expected[1], rel=1e-7)
