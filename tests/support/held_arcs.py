"""The hinge's quarter turn in least time with efforts held at limits, rightly or wrongly."""

import numpy as np

from linkplan.planner.closed_chain.case import MechanismCase, case_of
from linkplan.planner.refinement.case import Iterate, attempt
from linkplan.planner.refinement.constrained_arcs import FixedArcs
from linkplan.planner.refinement.switches import mesh_with_switches
from tests.support.bodies import HINGE, QUARTER_TURN, body_plan, body_problem

FREE = QUARTER_TURN + 'duration_s = "free"\n'


def held_case() -> MechanismCase:
    """Return the case of the turn."""
    return case_of(body_problem(HINGE, FREE, "objective.minimize=time"))


def held(efforts: list[float], switches: list[float]) -> Iterate:
    """Return what is found with efforts [N.m], NaN where free, held between switches, shares of the least time."""
    quick, case = body_plan(HINGE, FREE, "objective.minimize=time"), held_case()
    T = quick.trajectory.duration_s
    mesh, durations = mesh_with_switches(np.array([0.0, T]), np.array(switches) * T, 20)
    fixed = FixedArcs(efforts=np.array(efforts)[:, None], paths=np.zeros((len(efforts), 0), dtype=int))
    start = case.start_from(quick.trajectory)
    found = attempt(case, start, mesh, durations, "held", warm=True, fixed=fixed)
    assert found is not None
    return found
