"""The whole pose at measured positions: on the assembly branch of a pose far away, and without it beyond a gap."""

import casadi as ca
import numpy as np
import pytest

from linkplan.controllers.trackers.computed_torque import ComputedTorque
from linkplan.models.mechanism import load_mechanism
from linkplan.models.poses.assembly import follow
from linkplan.models.reduction.closing import closed_near
from tests.support.machines import reach


@pytest.mark.parametrize("by", [-0.6, 0.4, 0.8])
def test_a_pose_is_closed_on_the_branch_of_one_far_away(by):
    mechanism = load_mechanism("optimus-knee")
    near, s = ca.MX.sym("near", mechanism.n_q), ca.MX.sym("s", 1)
    close = ca.Function("close", [near, s], list(closed_near(mechanism.dynamics, near, s)))
    position = mechanism.home[mechanism.independent] + by
    q, gap = (np.array(value).ravel() for value in close(mechanism.home, position))
    way = mechanism.home[mechanism.independent] + by * np.linspace(0.0, 1.0, 50)[:, None]
    assert q == pytest.approx(follow(mechanism, way, mechanism.home)[-1], abs=1e-7)
    assert gap[0] < 1e-7


@pytest.mark.parametrize(("gap_m", "measured"), [(3e-7, True), (3e-6, False)])
def test_computed_torque_answers_for_the_reference_s_pose_where_the_loop_leaves_a_gap(gap_m, measured):
    mechanism, reference = reach()
    near, s, v, a = (ca.MX.sym(name, n) for name, n in (("near", mechanism.n_q), ("s", 1), ("v", 1), ("a", 1)))
    tracker = ComputedTorque(
        reference=reference, acceleration=np.zeros((reference.n, 1)), stiffness=0.0, damping=0.0,
        law=ca.Function("law", [near, s, v, a], [s, ca.MX(gap_m)]),
    )  # fmt: skip
    there = reference.position_rad[3] + 0.2
    assert tracker.effort(3, there, reference.velocity_rad_s[3]) == pytest.approx(
        there if measured else reference.position_rad[3]
    )
