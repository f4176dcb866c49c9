"""The unit of a problem's objective, which depends on its actuators for efforts and on its joints for distances."""

from linkplan.planner.problem.problem import Problem


def objective_unit(problem: Problem) -> str:
    """Return the unit of a single term, after a space; an empty string for a sum of terms."""
    terms = list(problem.objective.weights)
    unit, mechanism = problem.objective.unit, problem.mechanism
    if not unit:
        return ""
    units = [unit]
    if terms[0].startswith("effort"):
        of_kind = {"N.m": unit, "N": unit.replace("N2 m2", "N2")}
        units = [of_kind[actuator.unit] for actuator in mechanism.actuators]
    elif terms[0] == "tracking":
        units = [unit if joint.kind == "hinge" else unit.replace("rad2", "m2") for joint in mechanism.independent_joints]
    return f" {' and '.join(dict.fromkeys(units))}"
