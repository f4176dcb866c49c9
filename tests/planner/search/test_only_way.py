"""What every motion of one freedom passes is refused without a solve, to a millionth: a joint's range, a singular margin."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.limits.joints import RangeLimit, SingularMarginLimit
from linkplan.planner.limits.kinds import limits_of
from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.presolve import ONLY_WAY_SLACK, only_way, sentence_beyond
from tests.support.plans import problem_of

# Shares of the allowance, a millionth, on both sides of it.
WITHIN, BEYOND = 0.5e-6, 2e-6


def limited(**changes) -> Problem:
    problem = problem_of("knee-reach")
    return replace(problem, limits=replace(problem.limits, **changes))


def beyond(problem: Problem) -> str | None:
    limits = [limit for limit in limits_of(problem) if isinstance(limit, RangeLimit | SingularMarginLimit)]
    return sentence_beyond(problem, limits, only_way(problem), None, ONLY_WAY_SLACK)


@pytest.mark.parametrize(("short", "refused"), [(WITHIN, False), (BEYOND, True)])
def test_a_dependent_joint_beyond_its_range_is_refused(short, refused):
    mechanism = limited().mechanism
    joint = int(mechanism.dependent[0])
    most = only_way(limited())[:, joint].max()
    ranges = np.array(limited().limits.position)
    ranges[joint] = [-np.inf, most - short]
    said = beyond(limited(position=ranges))
    assert (said is not None) == refused
    if said is not None:
        assert f"joint {mechanism.joints[joint].name} stands at" in said


@pytest.mark.parametrize(("more", "refused"), [(-WITHIN, False), (WITHIN, False), (BEYOND, True)])
def test_a_pose_short_of_the_singular_margin_is_refused(more, refused):
    least = singularity_ratios(limited(), only_way(limited())).min()
    assert 0.0 < least < 1.0
    said = beyond(limited(singular_margin=least * (1 + more)))
    assert (said is not None) == refused
    if said is not None:
        assert "short of its limit" in said
