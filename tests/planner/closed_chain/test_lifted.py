"""Lifted programs: dependent joints' rates, accelerations and multipliers as unknowns, the motions those of reduced ones."""

import numpy as np
import pytest

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.closed_chain import mechanics
from linkplan.planner.closed_chain.mechanics import NodeTerms, mechanism_system
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.instant import Scales
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import plan_motion
from tests.support.hexapod import hexapod
from tests.support.tolerances_planner import MINIMUM_TIME, ROWS

# A dependent joint's speed in the five-bar's reach comes to more than this where nothing limits it [deg/s].
FASTEST = 300.0


def lifted_rows_along(mechanism: Mechanism, rng: np.random.Generator, *, wrong: float = 0.0) -> np.ndarray:
    """Return a lifted node's equations where speeds and efforts are random and accelerations theirs, all units one."""
    n_s, q = mechanism.dof, mechanism.home
    v, u = rng.normal(size=n_s), rng.normal(size=mechanism.n_u)
    a = np.array(mechanism.dynamics.acceleration(q, v, u)).ravel() * (1 + wrong)
    ones = Scales(time_s=1.0, position=np.ones(n_s), effort=np.ones(mechanism.n_u), residual=np.ones(n_s), length_m=1.0)
    system = mechanism_system(mechanism, NodeTerms())
    own = mechanics.lifted_start(mechanism, q[None], v[None], a[None], u[None], 1.0, ones.force)[0]
    xi = np.concatenate([q[mechanism.independent], v, a, q[mechanism.dependent], own, u])
    return np.array(system.node(xi, ones.vector())).ravel()[: system.n_equations]


@pytest.mark.parametrize("model", ["five-bar", "andrews-squeezer", hexapod()], ids=["five-bar", "squeezer", "hexapod"])
def test_rows_of_a_lifted_node_are_kept_by_the_reduced_dynamics(model, monkeypatch):
    monkeypatch.setattr(mechanics, "_MAX_ELIMINATION_OPERATIONS", 0)
    mechanism, rng = load_mechanism(model), np.random.default_rng(3)
    assert mechanics.is_lifted(mechanism)
    assert np.abs(lifted_rows_along(mechanism, rng)).max() < ROWS
    assert np.abs(lifted_rows_along(mechanism, rng, wrong=1e-3)).max() > 100 * ROWS


def test_loops_that_close_together_are_lifted_and_those_that_follow_one_another_are_not():
    assert mechanics.is_lifted(load_mechanism(hexapod()))
    assert not mechanics.is_lifted(load_mechanism("andrews-squeezer"))


@pytest.mark.slow
@pytest.mark.parametrize("fastest", [None, FASTEST], ids=["free", "a dependent joint's speed limited"])
def test_a_lifted_program_has_the_reduced_ones_answer(fastest, monkeypatch):
    def planned() -> Plan:
        """Return the plan of a mechanism of its own: what is built is kept by mechanism."""
        limits = [] if fastest is None else [f"limits.speed_deg_s.P={fastest}"]
        return plan_motion(load_problem("five-bar-reach", limits))

    reduced = planned()
    monkeypatch.setattr(mechanics, "_MAX_ELIMINATION_OPERATIONS", 0)
    same = planned()
    assert mechanics.is_lifted(same.problem.mechanism)
    assert (reduced.status, same.status) == ("optimal", "optimal"), same.message
    assert same.objective == pytest.approx(reduced.objective, rel=MINIMUM_TIME)


@pytest.mark.long
def test_a_platform_on_six_rods_is_raised_and_turned():
    goal = {f"s{k}": 0.03 + 0.02 * (-1) ** k for k in range(6)}
    ends = {"start_m": {f"s{k}": 0.0 for k in range(6)}, "goal_m": goal}
    plan = plan_motion(Problem.reach(hexapod(), **ends, duration_s=0.5, mesh={"intervals": 10}))
    assert plan.status == "optimal", plan.message


def test_an_open_tree_of_many_joints_has_nothing_to_lift():
    links = "".join(f'<body pos="0.1 0 0"><joint name="j{k}"/><geom size="0.01" mass="0.1"/>' for k in range(34))
    tree = load_mechanism(f"<mujoco><worldbody>{links}{'</body>' * 34}</worldbody></mujoco>")
    assert mechanics.n_lifted(tree) == 0
    assert not mechanics.is_lifted(tree)
