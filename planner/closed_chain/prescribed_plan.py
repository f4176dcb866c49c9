"""The plan of a prescribed motion: the exact reference, or the limit that forbids it and the highest feasible frequency."""

import numpy as np

from linkplan.planner.certificate.certificate import certify
from linkplan.planner.closed_chain.answer import finished
from linkplan.planner.closed_chain.prescribed import highest_frequency, prescribe, reference_demand, rounded_down
from linkplan.planner.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import progress


def plan_prescribed(problem: Problem, start_pose: np.ndarray) -> Plan:
    """Return the plan of a reference that must be followed exactly."""
    progress("following the reference")
    demand = reference_demand(problem, start_pose)
    if demand is not None:
        progress("looking for the highest feasible frequency")
        frequency = highest_frequency(problem, start_pose)
        details = {"needed": demand.needed, "limit": demand.limit, "time_s": demand.time_s}
        remedy = "no slower one keeps the limits"
        if frequency is not None:
            details["highest_frequency_hz"] = frequency
            remedy = f"up to {rounded_down(frequency):g} Hz it keeps every limit"
        return Plan(
            problem=problem,
            status="infeasible",
            message=f"infeasible: {demand.sentence('following the reference exactly')}; at this amplitude {remedy};"
            ' motion.kind = "periodic" plans the nearest motion that keeps them',
            details=details,
        )
    trajectory = prescribe(problem, start_pose)
    certificate = certify(problem, trajectory)
    return finished(problem, trajectory, certificate, 0.0, "the reference keeps every limit and is followed exactly")
