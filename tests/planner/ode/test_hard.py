"""Problems that other programs solve with help: limits along which a motion is unstable, rates that are singular."""

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.ode.certificate import LIMIT_SLACK
from tests.support.ode import FREE_EFFORT, INF, solved
from tests.support.tolerances_planner import ALP_RIDER_PRINTED

# The Alp rider by the book's and PROPT's programs.
ALP_RIDER = 2030.85609


def terrain(t, exp=np.exp):
    """Return the least squared distance from the origin that the Alp rider keeps at times t."""
    humps = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
    return sum(height * exp(-slope * (t - at) ** 2) for height, at, slope in humps) + 0.01


@pytest.mark.long
def test_an_alp_rider_goes_over_every_hump_for_the_published_cost():
    """Betts (2010): stiff, unstable at 2 / s over 20 s, and at its limit from 0.4 s to 18.4 s, on a sphere of any pose."""
    plan = solved(
        rate=lambda x, u, p, t: [  # noqa: ARG005
            -10 * x[0] + u[0] + u[1],
            -2 * x[1] + u[0] + 2 * u[1],
            -3 * x[2] + 5 * x[3] + u[0] - u[1],
            5 * x[2] - 3 * x[3] + u[0] + 3 * u[1],
        ],
        start=[2, 1, 2, 1],
        goal=[2, 3, 1, -2],
        effort_limit=[*FREE_EFFORT, *FREE_EFFORT],
        duration_s=20.0,
        running_cost=lambda x, u, p, t: 100 * ca.sumsqr(x) + 0.01 * ca.sumsqr(u),  # noqa: ARG005
        path=lambda x, u, p, t: ca.sumsqr(x) - terrain(t, ca.exp),  # noqa: ARG005
        path_limit=[[0, INF]],
    )
    assert plan.objective == pytest.approx(ALP_RIDER, rel=ALP_RIDER_PRINTED)
    assert plan.certificate.integrated_objective == pytest.approx(plan.objective, rel=10 * plan.problem.tolerance)
    assert plan.certificate.integration_restarts
    t = plan.trajectory.dense_times(50)
    above = np.sum(plan.trajectory.state_at(t) ** 2, axis=1) - terrain(t)
    assert above.min() > -LIMIT_SLACK * above.max()
    assert np.mean(above < 1e-4) > 0.8  # it goes along the limit nearly all the time
