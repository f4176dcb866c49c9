"""The certificate of a given motion of a differential equation, in closed form."""

import numpy as np
import pytest

from linkplan.planner.limits.samples import sample_points
from linkplan.planner.ode.certificate import certify_ode, running_cost, sizes_of
from linkplan.planner.ode.problem import OdeProblem
from linkplan.planner.transcription.collocation import Curves
from linkplan.planner.transcription.schemes import scheme
from tests.support.ode import FREE_EFFORT, NAN, squared_effort

SPEED, DURATION_S, INTERVALS = 3.0, 2.0, 4


def judged(running: np.ndarray | None = None, efforts: np.ndarray | None = None, **given):
    """Return the certificate of x = SPEED t with x' = u, int u^2 and the final cost 5 x(T) - x(0) + T^2.

    `efforts` (INTERVALS,) are those that the solution claims, SPEED by default.
    """
    problem = OdeProblem(
        name="straight",
        rate=lambda x, u, p, t: [u[0]],  # noqa: ARG005
        duration_s=DURATION_S,
        running_cost=squared_effort,
        final_cost=lambda x0, xT, T, p: 5 * xT[0] - x0[0] + T**2,  # noqa: ARG005
        **{"start": [0], "goal": [NAN], "effort_limit": FREE_EFFORT} | given,
    )
    breaks = np.linspace(0.0, DURATION_S, INTERVALS + 1)
    motion = Curves(
        breaks_s=breaks,
        state=SPEED * np.array([breaks[:-1], breaks[1:]])[:, :, None],
        effort=np.full((1, INTERVALS, 1), SPEED) if efforts is None else efforts[None, :, None],
        running=running,
    )
    return certify_ode(problem, motion)


def limited(what: str, limit: list[float]):
    """Return the certificate with limits on the state, or on the same quantity of the path."""
    if what == "state":
        return judged(state_limit=[limit])
    return judged(path=lambda x, u, p, t: x[0], path_limit=[limit])  # noqa: ARG005


def left_of(certificate, kind: str) -> list[float]:
    """Return what is left to the limits of a kind."""
    return [margin.left for margin in certificate.margins if margin.what == kind]


OF_INTERVAL = SPEED**2 * DURATION_S / INTERVALS
FINAL = 5 * SPEED * DURATION_S + DURATION_S**2


@pytest.mark.parametrize("running", [None, np.full(INTERVALS, OF_INTERVAL)], ids=["unknown", "known"])
def test_the_objective_is_the_running_cost_and_the_final_cost(running):
    certificate = judged(running)
    assert certificate.passed, certificate.failures
    assert certificate.integrated_objective == pytest.approx(INTERVALS * OF_INTERVAL + FINAL, rel=1e-12)


@pytest.mark.parametrize(("excess", "far"), [(8e-4, False), (4e-3, True), (0.1, True)])
def test_the_objective_may_be_a_thousandth_of_its_size_from_that_of_the_integrated_motion(excess, far):
    certificate, running = judged(np.full(INTERVALS, OF_INTERVAL * (1 + excess))), INTERVALS * OF_INTERVAL
    assert certificate.objective_error == pytest.approx(excess * running / ((1 + excess) * running + FINAL), rel=1e-9)
    assert far == any("objective" in failure for failure in certificate.failures)


@pytest.mark.parametrize("what", ["state", "path"])
@pytest.mark.parametrize(("limit", "margin"), [([-1.0, 10.0], 1.0), ([-5.0, 8.0], 2.0), ([0.0, 5.5], -0.5)])
def test_a_margin_is_the_least_distance_to_the_limits(what, limit, margin):
    certificate = limited(what, limit)
    assert left_of(certificate, what)[0] == pytest.approx(margin, abs=1e-9)
    assert certificate.passed == (margin > 0)
    said = "state0 comes to" if what == "state" else "path quantity 0 comes to"
    assert any(said in failure for failure in certificate.failures) == (margin < 0)


def test_the_margin_of_a_state_is_measured_between_the_samples_too():
    """x = 1 - (t - a)^2 is largest at a, where no sample is."""
    a = 0.43
    assert np.abs(sample_points(2) - a).min() > 1e-3
    problem = OdeProblem(
        name="parabola", rate=lambda x, u, p, t: [u[0]], start=[1 - a**2], goal=[NAN], effort_limit=FREE_EFFORT,  # noqa: ARG005
        duration_s=1.0, running_cost=squared_effort, state_limit=[[-1.0, 1 - 1e-4]],
    )  # fmt: skip
    state = np.array([1 - a**2, 1 - a**2 + a, 1 - (1 - a) ** 2]).reshape(3, 1, 1)
    effort = np.array([2 * a, 2 * a - 2]).reshape(2, 1, 1)
    certificate = certify_ode(problem, Curves(breaks_s=np.array([0.0, 1.0]), state=state, effort=effort))
    assert certificate.integration_error < 1e-10
    assert left_of(certificate, "state") == pytest.approx([-1e-4], abs=1e-12)


@pytest.mark.parametrize(
    ("error", "share", "leaves"), [(0.0, 5e-9, False), (0.0, 1e-7, True), (5e-5, 5e-7, False), (5e-5, 3e-6, True)]
)
def test_a_state_may_leave_its_limits_by_rounding_and_if_it_is_integrated_with_an_error_by_a_millionth(error, share, leaves):
    efforts = np.full(INTERVALS, SPEED * (1 - error))
    certificate = judged(efforts=efforts, state_limit=[[-1.0, SPEED * DURATION_S * (1 - share)]])
    assert (certificate.integration_error < 1e-10) == (error == 0.0)
    assert certificate.margins[0].kept != leaves
    assert any("state0 comes to" in failure for failure in certificate.failures) == leaves


@pytest.mark.parametrize(("share", "ends_there"), [(5e-5, True), (5e-4, False)])
def test_the_integrated_state_may_end_a_ten_thousandth_of_its_size_away(share, ends_there):
    certificate = judged(efforts=np.full(INTERVALS, SPEED * (1 + share)))
    assert certificate.integration_error == pytest.approx(share, rel=1e-6)
    assert ends_there != any("the integrated state ends" in failure for failure in certificate.failures)


@pytest.mark.parametrize("what", ["state", "path"])
@pytest.mark.parametrize(
    ("upper", "touching"),
    [(6 + 3e-6, [0, 0, 0, 1]), (6 + 3e-5, [0, 0, 0, 0]), (4.5 + 2e-6, [0, 0, 1, 1]), (10.0, [0, 0, 0, 0])],
)
def test_an_interval_touches_a_limit_where_it_comes_to_it_on_a_part(what, upper, touching):
    """The state's size is 6: a millionth of it is at the limit. Beyond 4.5 a part of the last interval is at no limit."""
    certificate = limited(what, [-1.0, upper])
    expected = np.array(touching, dtype=bool)
    if upper < 5:
        expected[3] = False  # all of it is beyond the limit
    assert certificate.touching.tolist() == expected.tolist()


def test_an_overrun_is_the_largest_of_all_intervals_and_asks_for_refinement_there():
    """The integrated state ends 1e-3 of its size beyond a limit, in the last interval alone."""
    certificate = judged(state_limit=[[-1.0, SPEED * DURATION_S * (1 - 1e-3)]])
    assert certificate.overrun == pytest.approx(1e-3, rel=1e-6)
    assert certificate.growth == pytest.approx([0, 0, 0, 1e-3 / 1e-6 * 1e-8 / 1e-4], abs=1e-6)
    assert any("leaves its limits by 0.001 of its size" in failure for failure in certificate.failures)


def test_the_overrun_of_a_path_quantity_is_known_for_every_interval():
    certificate = limited("path", [-1.0, 4.0])
    assert certificate.margins[0].overrun * 4.0 == pytest.approx([0.0, 0.0, 0.5, 2.0], abs=1e-9)


def test_refinement_is_asked_for_where_a_state_s_own_interval_adds_its_error():
    """In shares of a ten thousandth: the effort of the third interval of four is wrong by 4e-3."""
    problem = OdeProblem(
        name="two", rate=lambda x, u, p, t: [u[0], 0], start=[0, 1], goal=[NAN, NAN], effort_limit=FREE_EFFORT,  # noqa: ARG005
        duration_s=DURATION_S, final_cost=lambda x0, xT, T, p: xT[0],  # noqa: ARG005
    )  # fmt: skip
    breaks = np.linspace(0.0, DURATION_S, INTERVALS + 1)
    state = np.array([[breaks[:-1] * SPEED, np.ones(INTERVALS)], [breaks[1:] * SPEED, np.ones(INTERVALS)]]).transpose(
        0, 2, 1
    )
    effort = SPEED * np.array([1.0, 1.0, 1 + 4e-3, 1.0])[None, :, None]
    certificate = certify_ode(problem, Curves(breaks_s=breaks, state=state, effort=effort))
    assert certificate.growth == pytest.approx([0.0, 0.0, 4e-3 / INTERVALS / 1e-4, 0.0], abs=1e-5)


def test_refinement_is_asked_for_where_the_running_cost_is_misjudged():
    """In shares of ten times a ten thousandth of the objective's size."""
    running = OF_INTERVAL * np.array([1.0, 1.1, 1.0, 1.0])
    certificate = judged(running)
    share = 0.1 * OF_INTERVAL / (running.sum() + FINAL)
    assert certificate.growth == pytest.approx([0.0, share / 10.0 / 1e-4, 0.0, 0.0], abs=1e-5)


@pytest.mark.parametrize(("values", "size"), [([5.0, 6.0], 6.0), ([-3.0, 3.0], 6.0), ([-1.0, 4.0], 5.0), ([0.0, 0.0], 1.0)])
def test_the_size_of_a_state_is_of_what_it_is_and_of_how_far_it_goes(values, size):
    assert sizes_of(np.array(values)[:, None]) == pytest.approx([size])


@pytest.mark.parametrize("name", ["trapezoid", "hermite-simpson", "radau-3", "gauss-2"])
def test_the_running_cost_of_an_interval_is_its_own_where_the_effort_jumps(name):
    problem = OdeProblem(
        name="jump", rate=lambda x, u, p, t: [u[0]], start=[0], goal=[NAN], effort_limit=FREE_EFFORT,  # noqa: ARG005
        duration_s=2.0, running_cost=squared_effort,
    )  # fmt: skip
    motion = Curves(
        breaks_s=np.array([0.0, 0.5, 2.0]), state=np.zeros((2, 2, 1)), effort=np.array([3.0, -1.0])[None, :, None]
    )
    assert running_cost(problem, motion, scheme(name)) == pytest.approx([9.0 * 0.5, 1.0 * 1.5], rel=1e-9)


@pytest.mark.parametrize(("limit", "excess"), [([-1.0, 10.0], 0.0), ([-5.0, 2.5], 0.5), ([3.25, 9.0], 0.25)])
def test_an_effort_is_refused_by_the_most_that_it_exceeds_its_limits(limit, excess):
    certificate = judged(effort_limit=[limit])
    assert max(0.0, -min(left_of(certificate, "effort"))) == pytest.approx(excess)
    assert any(failure.startswith("effort") for failure in certificate.failures) == (excess > 0)


@pytest.mark.parametrize(
    ("asked", "missed"),
    [
        ({"start": [1.5]}, 1.5 / (SPEED * DURATION_S)),
        ({"goal": [SPEED * DURATION_S + 1.5]}, 1.5 / (SPEED * DURATION_S)),
        ({"start": [NAN], "returns": [0]}, 1.0),
        ({"ends": lambda x0, xT, T, p: [xT[0] - x0[0]], "ends_limit": [[-1.0, 5.5]]}, 0.5 / (SPEED * DURATION_S)),  # noqa: ARG005
    ],
    ids=["start", "goal", "return", "ends"],
)
def test_a_boundary_condition_that_is_missed_is_said_with_the_share_of_its_size(asked, missed):
    certificate = judged(**asked)
    assert certificate.boundary_error == pytest.approx(missed, rel=1e-12)
    assert any("are missed by" in failure for failure in certificate.failures)
