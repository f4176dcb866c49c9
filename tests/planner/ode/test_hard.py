"""Problems that other programs solve with help: limits along which a motion is unstable, rates that are singular."""

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.ode.certificate import LIMIT_SLACK
from linkplan.planner.ode.problem import OdeProblem
from tests.support.ode import FREE_EFFORT, INF, NAN, solved
from tests.support.tolerances_planner import ALP_RIDER_PRINTED, BIOREACTOR_OBJECTIVE

# The bioreactor with rates constant over 100 and over 400 equal cells, by Runge and Kutta's rule in steps of 1/40, multiple
# shooting: 6.1515914 and 6.1516030, and what these tend to with the square of the cells' width.
LEE_RAMIREZ = 6.1516037
# The Alp rider by the book's and PROPT's programs.
ALP_RIDER = 2030.85609


def bioreactor() -> OdeProblem:
    """Return Lee and Ramirez's fed-batch reactor with rates of nutrient and inducer within 0 and 1, inducer for nothing.

    Volume, cells, nutrient, protein, inducer, shock and recovery; the parameters are Tholudur and Ramirez's (1997).
    """

    def rate(x, u, p, t):  # noqa: ARG001
        volume, cells, nutrient, protein, inducer, shock, recovery = (x[i] for i in range(7))
        dilution, uptake = (u[0] + u[1]) / volume, nutrient / (14.35 + nutrient + nutrient**2 / 111.5)
        growth = uptake * (shock + recovery * 0.22 / (0.22 + inducer))
        production = 0.233 * uptake * (0.0005 + inducer) / (0.022 + inducer)
        response = 0.09 * inducer / (0.034 + inducer)
        return [
            u[0] + u[1],
            growth * cells - dilution * cells,
            100 * u[0] / volume - dilution * nutrient - growth * cells / 0.51,
            production * cells - dilution * protein,
            4 * u[1] / volume - dilution * inducer,
            -response * shock,
            response * (1 - recovery),
        ]

    return OdeProblem(
        name="Lee-Ramirez",
        rate=rate,
        start=[1, 0.1, 40, 0, 0, 1, 0],
        goal=[NAN] * 7,
        effort_limit=[[0, 1], [0, 1]],
        duration_s=10.0,
        final_cost=lambda x0, xT, T, p: -xT[0] * xT[3],  # noqa: ARG005
    )


@pytest.mark.slow
def test_a_bioreactor_is_fed_along_singular_arcs_and_limits_as_an_independent_program_has_it():
    problem = bioreactor()
    plan = solved(problem)
    assert -plan.objective == pytest.approx(LEE_RAMIREZ, rel=BIOREACTOR_OBJECTIVE)
    assert plan.certificate.integrated_objective == pytest.approx(plan.objective, rel=10 * problem.tolerance)


def terrain(t, exp=np.exp):
    """Return the least squared distance from the origin that the Alp rider keeps at times t."""
    humps = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
    return sum(height * exp(-slope * (t - at) ** 2) for height, at, slope in humps) + 0.01


@pytest.mark.long
def test_an_alp_rider_goes_over_every_hump_for_the_published_cost():
    """Betts (2010): stiff, unstable at 2 / s over 20 s, and at its limit from 0.4 s to 18.4 s, on a sphere of any pose."""
    plan = solved(
        OdeProblem(
            name="Alp rider",
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
    )
    assert plan.objective == pytest.approx(ALP_RIDER, rel=ALP_RIDER_PRINTED)
    assert plan.certificate.integrated_objective == pytest.approx(plan.objective, rel=10 * plan.problem.tolerance)
    assert plan.certificate.integration_restarts
    t = plan.trajectory.dense_times(50)
    above = np.sum(plan.trajectory.state_at(t) ** 2, axis=1) - terrain(t)
    assert above.min() > -LIMIT_SLACK * above.max()
    assert np.mean(above < 1e-4) > 0.8  # it goes along the limit nearly all the time
