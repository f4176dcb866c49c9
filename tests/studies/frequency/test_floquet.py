"""Along a periodic motion: multipliers beside closed forms, and beside the decay of disturbances in MuJoCo."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.controllers.reference import sample
from linkplan.controllers.sampling import sampling
from linkplan.models.errors import LinkplanError
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.feedback.bode.along_motion import along_motion
from linkplan.studies.feedback.frequency.floquet import floquet, frozen_radii, linear_law
from tests.support.tolerances_loops import DECAY, LIOUVILLE


@pytest.fixture(scope="module")
def plan():
    return plan_motion(load_problem("knee-sine"))


def along(plan, law, **settings):
    """Return the multipliers of a tracker of the plan with its settings changed."""
    problem = replace(plan.problem, tracking=plan.problem.tracking.replace(**settings))
    plan = replace(plan, problem=problem)
    tracking, mechanism = problem.tracking, problem.mechanism
    reference = sample(mechanism, plan.trajectory, tracking.period_s, plan.trajectory.duration_s)
    timing = sampling(mechanism, tracking.period_s, tracking.delay_periods)
    tracker = build_tracker(law, plan, reference)
    return floquet(mechanism, reference, tracker, timing, problem.limits.effort), reference, tracker, timing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "settings"),
    [
        ("pd+ff", {"kp": 2.0, "kd": 0.005}),
        ("pd+ff", {"kp": 0.5, "kd": 0.002}),
        ("pd+ff", {"kp": 1.0, "kd": 0.006, "delay_periods": 2}),
        ("pd", {"kp": 2.0, "kd": 0.005}),
        ("pd", {"kp": 0.5, "kd": 0.002}),
    ],
)
def test_multipliers_predict_the_decay_a_cycle_leaves_in_mujoco(plan, law, settings):
    found, *_ = along(plan, law, **settings)
    predicted, measured = found.multiplier_size[:2], found.measured_multiplier_size[:2]
    assert 1e-4 < predicted[0] < 0.9
    assert measured == pytest.approx(predicted, rel=DECAY)
    assert found.converges


@pytest.mark.slow
@pytest.mark.parametrize("law", ["pd", "pd+ff", "lqr"])
def test_the_problems_own_trackers_let_a_disturbance_die_as_predicted(plan, law):
    found, *_ = along(plan, law)
    assert found.log_left_predicted < np.log(1e-4)
    assert found.log_left_measured == pytest.approx(found.log_left_predicted, rel=DECAY)
    assert 0 < found.seen_s <= found.cycle_s


@pytest.mark.slow
def test_determinant_of_the_monodromy_is_the_product_of_the_steps_determinants(plan):
    # Liouville: det A_k - B_k K_k of the joint with damping kd is 1 - kd T / J in MuJoCo's steps, whatever the motion.
    found, reference, *_ = along(plan, "pd+ff", kp=0.5, kd=0.002)
    mechanism = plan.problem.mechanism
    inertia = np.array([float(mechanism.dynamics.reduced_inertia(pose)) for pose in reference.pose_rad])
    slope = np.gradient(np.log(inertia), reference.position_rad[:, 0])
    # J s'' + J' / 2 s'^2 = u: the speed's own derivative of the acceleration is -J' / J s'.
    factor = 1 - reference.period_s * (0.002 / inertia + slope * reference.velocity_rad_s[:, 0])
    assert np.linalg.det(found.monodromy) == pytest.approx(np.prod(factor), rel=LIOUVILLE)


@pytest.mark.slow
def test_a_loop_that_is_stable_nowhere_along_the_motion_does_not_converge(plan):
    found, reference, tracker, timing = along(plan, "pd+ff", kp=200.0, kd=10.0)
    assert not found.converges
    assert frozen_radii(plan.problem.mechanism, reference, linear_law(tracker).gains, timing).min() > 1


@pytest.mark.slow
def test_a_motion_that_does_not_repeat_after_whole_periods_has_no_multipliers(plan):
    with pytest.raises(LinkplanError, match="whole control periods"):
        along(plan, "pd+ff", period_s=1.7e-4)


@pytest.mark.slow
def test_the_loop_frozen_along_a_reach_has_margins_at_every_instant_and_no_multipliers():
    plan = plan_motion(load_problem("knee-reach"))
    found = along_motion(plan, "lqr", plan.problem.tracking)
    assert found.floquet is None
    assert all(bounds.stable for bounds in found.frozen)
    assert found.largest_frozen_pole < 1
    assert found.worst.disk_margin == min(bounds.disk_margin for bounds in found.frozen)
