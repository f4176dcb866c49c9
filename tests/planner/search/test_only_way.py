"""What every motion of one freedom passes is refused without a solve, to a millionth: a joint's range, a singular margin."""

from dataclasses import replace

import numpy as np
import pytest

from linkplan.planner.limits.samples import singularity_ratios
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.presolve import _range_on_the_only_way, only_way
from tests.support.plans import problem_of

# Shares of the allowance, a millionth, on both sides of it.
WITHIN, BEYOND = 0.5e-6, 2e-6


def limited(**changes) -> Problem:
    problem = problem_of("knee-reach")
    return replace(problem, limits=replace(problem.limits, **changes))


@pytest.mark.parametrize(("short", "refused"), [(WITHIN, False), (BEYOND, True)])
def test_a_dependent_joint_beyond_its_range_is_refused(short, refused):
    mechanism = limited().mechanism
    joint = int(mechanism.dependent[0])
    most = only_way(limited())[:, joint].max()
    ranges = np.array(limited().limits.position)
    ranges[joint] = [-np.inf, most - short]
    said = _range_on_the_only_way(limited(position=ranges))
    assert (said is not None) == refused
    if said is not None:
        assert f"joint {mechanism.joints[joint].name} stands at" in said


@pytest.mark.parametrize(("more", "refused"), [(-WITHIN, False), (WITHIN, False), (BEYOND, True)])
def test_a_pose_short_of_the_singular_margin_is_refused(more, refused):
    least = singularity_ratios(limited(), only_way(limited())).min()
    assert 0.0 < least < 1.0
    said = _range_on_the_only_way(limited(singular_margin=least * (1 + more)))
    assert (said is not None) == refused
    if said is not None:
        assert "short of limits.singular_margin" in said
