"""The mismatch of a comparison: a factor on masses, and a delay that may be a fraction of a period."""

import numpy as np
import pytest

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.compare import build_tracker, delay_of, mismatch_of, track, tracking_reference
from tests.support.plans import optimal


def test_a_fraction_of_a_period_of_delay_acts_as_in_an_ensemble():
    plan = optimal("knee-reach")
    mismatch = mismatch_of(plan, 1.0, 0.4)
    assert mismatch.name.endswith("0.4 control periods of delay")
    found = track(plan, "pd", mismatch)
    reference, mechanism = tracking_reference(plan), plan.problem.mechanism
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=np.array(plan.problem.limits.actuators_effort)))
    delayed = simulate(
        plant, build_tracker("pd", plan, reference), reference, [Imperfections(clock=Clock(delay_periods=0.4))]
    )
    np.testing.assert_allclose(found.position_rad[:, 0], delayed.pose[:, 0, mechanism.independent[0]], rtol=0, atol=1e-12)
    whole = track(plan, "pd", None)
    assert np.abs(found.position_rad - whole.position_rad).max() > 1e-6


@pytest.mark.parametrize("delay", [-0.5, float("nan"), 1e9])
def test_a_delay_that_is_none_is_refused(delay):
    with pytest.raises(ProblemError, match="delay_periods"):
        delay_of(delay, "delay_periods")
