"""Claims on sites' places: their enclosures at a pose against the arm's kinematics by hand."""

from dataclasses import replace

import numpy as np
import pytest
from flint import arb

from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import SiteLimit
from linkplan.planner.proof.claims import Claim, claims_of
from linkplan.planner.proof.motion import State
from linkplan.planner.proof.walk import blocks_of
from tests.support.arms import LOWER, UPPER, foot_of
from tests.support.random_motions import motion_of
from tests.support.sites import ABOVE, BELOW, arm_of, site_problem

POSE = np.array([0.7, -1.1])
NORMAL, THROUGH = np.array([3.0, 0.0, 4.0]) / 5.0, np.array([0.9, 5.0, 0.2])


def site_claim(problem: Problem) -> Claim:
    """Return the claim on the only limit on a site."""
    _, still = motion_of(problem.mechanism, np.random.default_rng(0))
    (claim,) = [claim for claim in claims_of(problem, still)[0] if "of site foot" in claim.name]
    return claim


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
    still = dict.fromkeys(("z", "v", "u"), ()) | {"rate": arb(1), "time": arb(0), "piece": None}
    at = State(blocks=blocks_of(problem.mechanism), s=[arb(x) for x in POSE], **still)
    (value,) = site_claim(problem).values(at)
    expected = quantity(foot_of(POSE)[0])
    assert abs(float(value.mid()) - expected) < 1e-12
    assert float(value.rad()) < 1e-12


@pytest.mark.parametrize("radius_m", [0.05, 3.0])
def test_a_tube_is_kept_within_its_radius_and_the_rounding_that_a_certificate_allows(radius_m):
    problem = site_problem(arm_of(UPPER, LOWER), {"start_at": {"foot": ABOVE}, "goal_at": {"foot": BELOW}})
    index = problem.mechanism.model.site("foot").id
    along = np.array([ABOVE, BELOW])
    tube = SiteLimit(site="foot", index=index, what="tube", name="foot", low=0.0, high=radius_m, along=along)
    claim = site_claim(replace(problem, limits=replace(problem.limits, site=(tube,))))
    assert claim.marks[1] == pytest.approx((radius_m + 1e-9 * max(1.0, radius_m)) ** 2, rel=1e-15)
    assert claim.marks[1] > radius_m**2
