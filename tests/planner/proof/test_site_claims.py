"""Claims on sites' places: their enclosures at a pose against the arm's kinematics by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from flint import arb

from linkplan.planner.proof.claims import site_claims
from tests.support.arms import LOWER, UPPER, foot_of
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem

POSE = np.array([0.7, -1.1])
NORMAL, THROUGH = np.array([3.0, 0.0, 4.0]) / 5.0, np.array([0.9, 5.0, 0.2])


@pytest.mark.parametrize(
    ("limit", "quantity"),
    [
        ({"normal": (5 * NORMAL).tolist(), "at": THROUGH.tolist()}, lambda foot: NORMAL @ (foot - THROUGH)),
        ({"z": [-0.5, 0.5]}, lambda foot: foot[2]),
    ],
    ids=["wall", "box"],
)
def test_a_claim_encloses_the_place_of_a_site(limit, quantity):
    problem = site_problem(arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}}, {"foot": limit})
    (claim,) = site_claims(problem, None)
    (value,) = claim.values(SimpleNamespace(q=[arb(x) for x in POSE]))
    expected = quantity(foot_of(POSE)[0])
    assert abs(float(value.mid()) - expected) < 1e-12
    assert float(value.rad()) < 1e-12
