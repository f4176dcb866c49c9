"""The nonlinear program: its hand-assembled derivatives, its rows at a true motion, its units, its book-keeping."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest

from linkplan.planner.closed_chain.guess import first_guess, guess_from
from linkplan.planner.closed_chain.transcribe import Transcribed, choose_scales, trajectory_of, transcribe
from linkplan.planner.solvers.solve import solve
from linkplan.planner.transcription.mesh import Mesh, segmented, uniform
from tests.support.plans import planned, problem_of
from tests.support.sites import arm_of, site_problem
from tests.support.tolerances_planner import DERIVATIVE, DIFFERENCE, ROWS, SAME_MOTION, STILL

BASES = {"effort": "knee-reach", "tracking": "knee-sine-shank", "time": "knee-sprint"}
SPEEDS = ("limits.speed_deg_s.O=2000", "limits.speed_deg_s.C=[-1500,1600]")
CASES = [
    (objective, segments, scheme, speeds, positions, False)
    for objective, scheme in (("effort", "radau-3"), ("tracking", "radau-3"), ("time", "radau-3"))
    for segments in (1, 2)
    for speeds, positions in ((False, False), (True, True))
]
CASES += [
    ("effort", 1, "hermite-simpson", True, False, False),
    ("tracking", 1, "radau-1", False, True, False),
    ("time", 2, "radau-2", True, False, False),
    ("effort", 1, "radau-3", False, False, True),
    ("effort", 2, "radau-3", True, True, True),
    # Limits that jump with the effort are looked at where no node stands: Radau's left end, both of Gauss's.
    ("effort", 2, "radau-3", "jumping", False, False),
    ("time", 1, "gauss-2", "jumping", True, False),
    # Limits on power at every instant: products of coefficients.
    ("time", 2, "radau-3", "powers", True, False),
    ("effort", 1, "gauss-2", "powers", False, True),
]
JUMPING = ("limits.power_w.act_O=500", "limits.closure_force.B=20", "limits.speed_deg_s.C=[-1500,1600]")


def name_of(case: tuple) -> str:
    words = zip(("speed rows", "position rows", "least limit"), case[3:], strict=True)
    return ", ".join([case[0], case[2], f"{case[1]} segments", *(word for word, on in words if on)])


@cache
def built(case: tuple) -> Transcribed:
    """Return a small program of a case, from the built-in plan of its objective."""
    objective, segments, scheme, speeds, positions, least = case
    plan = planned(BASES[objective])
    # Interpreted: compiled functions cannot be differentiated again, which is how the assembled derivatives are judged.
    settings = (
        "mesh.scheme=" + scheme,
        "mesh.intervals=6",
        "solver.compile=never",
        *({True: SPEEDS, "jumping": JUMPING, "powers": JUMPING}.get(speeds, ())),
    )
    problem = problem_of(BASES[objective], *settings)
    duration = plan.trajectory.duration_s
    durations = duration * (np.array([1.0]) if segments == 1 else np.array([0.4, 0.6]))
    mesh = uniform(3) if segments == 1 else segmented(durations, 6)
    rows = {"position_rows": positions, "enclosed": speeds == "powers"}
    return transcribe(problem, guess_from(plan.trajectory), mesh, durations, **rows, least_limit=least)


def point(transcribed: Transcribed, seed: int) -> np.ndarray:
    """Return random unknowns about the guess, efforts and durations among them."""
    noise = np.random.default_rng(seed).normal(size=transcribed.start.size)
    return transcribed.start + 0.05 * noise


def symbols(transcribed: Transcribed):
    nlp = transcribed.program.functions["nlp"]
    x, p = ca.MX.sym("x", nlp.size1_in(0)), ca.MX.sym("p", nlp.size1_in(1))
    return x, p, *nlp(x, p)


def assert_same(actual, expected) -> None:
    actual, expected = np.array(actual), np.array(expected)
    assert np.abs(expected).max() > 0
    assert np.abs(actual - expected).max() <= DERIVATIVE * np.abs(expected).max()


# The first case is quick, for mutants of the assembly.
every_case = pytest.mark.parametrize(
    "case", [CASES[0], *(pytest.param(case, marks=pytest.mark.slow) for case in CASES[1:])], ids=name_of
)


@every_case
def test_the_assembled_hessian_is_the_upper_triangle_of_the_lagrangian_s(case):
    transcribed = built(case)
    x, p, f, g = symbols(transcribed)
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lam", g.numel())
    lagrangian = sigma * f + ca.dot(multipliers, g)
    hessian = ca.Function("H", [x, p, sigma, multipliers], [ca.triu(ca.hessian(lagrangian, x)[0])])
    for seed in (5, 6):
        weights = np.random.default_rng(seed).normal(size=g.numel())
        at = point(transcribed, seed), transcribed.parameters, 0.7, weights
        assert_same(transcribed.program.hess_lag()(*at), hessian(*at))


def assert_derivatives(transcribed: Transcribed) -> None:
    """Check the assembled derivatives against differences along a random direction."""
    functions, p = transcribed.program.functions, transcribed.parameters
    x, rng = point(transcribed, 7), np.random.default_rng(8)
    direction, weights = rng.normal(size=x.size), rng.normal(size=transcribed.program.n_rows)

    def difference(of, step: float = 1e-5) -> np.ndarray:
        ahead, behind, far, back = (np.array(of(x + k * step * direction)).ravel() for k in (1, -1, 2, -2))
        return (8 * (ahead - behind) - (far - back)) / (12 * step)

    def lagrangian(at: np.ndarray) -> ca.DM:
        return 0.7 * functions["grad_f"](at, p)[1] + functions["jac_g"](at, p)[1].T @ weights

    rows = np.array(functions["jac_g"](x, p)[1] @ direction).ravel()
    slope = float(ca.dot(functions["grad_f"](x, p)[1], direction))
    bend = np.array(ca.triu2symm(transcribed.program.hess_lag()(x, p, 0.7, weights)) @ direction).ravel()
    assert np.abs(rows - difference(lambda at: functions["nlp"](at, p)[1])).max() < DIFFERENCE * np.abs(rows).max()
    assert abs(slope - difference(lambda at: functions["nlp"](at, p)[0])[0]) < DIFFERENCE * max(1.0, abs(slope))
    assert np.abs(bend - difference(lagrangian)).max() < DIFFERENCE * max(1.0, np.abs(bend).max())


@every_case
def test_the_assembled_derivatives_agree_with_differences_along_a_random_direction(case):
    assert_derivatives(built(case))


@pytest.mark.parametrize("durations", [[0.5], [0.2, 0.3]], ids=["1 segment", "2 segments"])
def test_so_do_those_of_a_program_whose_goal_is_a_place_of_a_site(durations):
    motion = {"start_deg": {"J1": 60.0, "J2": 40.0, "J3": 20.0}, "goal_at": {"foot": [0.2, 0.0, -0.3]}, "duration_s": 0.5}
    problem = site_problem(arm_of(0.25, 0.2, 0.15), motion, solver={"compile": "never"})
    mesh = uniform(3) if len(durations) == 1 else segmented(np.array(durations), 6)
    guess = first_guess(problem, problem.start_pose())
    transcribed = transcribe(problem, guess, mesh, np.array(durations))
    assert transcribed.formulation.endpoint is not None
    assert_derivatives(transcribed)


@pytest.mark.parametrize("name", ["knee-reach", "knee-sprint", "knee-sine-shank"])
def test_a_planned_motion_written_back_keeps_every_row(name):
    plan = planned(name)
    mesh, durations = mesh_of(plan)
    problem = plan.problem.varied(mesh=plan.problem.mesh.replace(scheme=plan.scheme))  # its degree may have been raised
    transcribed = transcribe(problem, guess_from(plan.trajectory), mesh, durations)
    x = np.array(transcribed.start)  # holds back from the limits, where a guess wants room and a plan does not
    x[transcribed.program.layout.effort()] = plan.trajectory.effort.transpose(1, 0, 2) / transcribed.units.effort
    rows = np.array(transcribed.program.functions["nlp"](x, transcribed.parameters)[1]).ravel()
    assert np.all(rows >= transcribed.row_lower - ROWS)
    assert np.all(rows <= transcribed.row_upper + ROWS)


def mesh_of(plan) -> tuple[Mesh, np.ndarray]:
    """Return a plan's final mesh as one segment of its own widths."""
    widths = np.diff(plan.trajectory.breaks_s)
    duration = widths.sum()
    return Mesh(fraction=widths / duration, segment=np.zeros(len(widths), dtype=int)), np.array([duration])


def test_following_the_reference_costs_nothing_and_a_constant_error_costs_its_square():
    problem = problem_of("knee-sine-shank", "solver.compile=never")
    guess = first_guess(problem, problem.start_pose())
    numbered = transcribe(problem, guess, uniform(10), np.array([guess.duration_s]))
    program, off = numbered.program, np.array(numbered.start)
    off[program.layout.states()[:, 0]] += 0.1  # of the unit of positions
    followed, missed = (float(program.functions["nlp"](x, numbered.parameters)[0]) for x in (numbered.start, off))
    assert followed < 1e-4 * missed  # the weight on the efforts' rates
    assert missed - followed == pytest.approx(0.1**2, rel=1e-9)


def test_every_effort_has_the_weight_of_effort_beside_the_weight_of_time():
    settings = ("objective.minimize={ effort = 1.0, time = 3.0 }", "motion.duration_s=free", "solver.compile=never")
    problem = problem_of("five-bar-reach", *settings)
    guess = first_guess(problem, problem.start_pose())
    transcribed = transcribe(problem, guess, uniform(4), np.array([guess.duration_s]))
    x, effort = np.array(transcribed.start), transcribed.program.layout.effort()

    def cost(*halves: int) -> float:
        """Return the cost of the guess's duration with these actuators at half their limits and the others at rest."""
        x[effort.ravel()] = 0.0
        x[effort[:, :, list(halves)].ravel()] = 0.5
        return float(transcribed.program.functions["nlp"](x, transcribed.parameters)[0])

    limits = problem.limits.actuators_effort[:, 1]
    for actuator, limit in enumerate(limits):
        assert (cost(actuator) - cost()) / cost() == pytest.approx((0.5 * limit) ** 2 / 3.0, rel=1e-9)


def row_kinds(interval) -> tuple[str, ...]:
    """Return the kind of each row of an interval."""
    at_open_ends = tuple(interval.node_kinds[i] for i in interval.open_end_rows)
    return interval.own_kinds + interval.n_nodes * interval.node_kinds + interval.n_open_ends * at_open_ends


def test_an_open_loop_breaks_the_closure_rows_by_its_gap():
    transcribed = built(CASES[0])
    layout, local = transcribed.program.layout, transcribed.program.interval
    x = np.array(transcribed.start)
    x[layout.dependent()[1, 2, 0]] += 0.01
    before, after = (
        np.array(transcribed.program.functions["nlp"](at, transcribed.parameters)[1]).ravel()
        for at in (transcribed.start, x)
    )
    changed = np.flatnonzero(np.abs(after - before) > STILL)
    kinds = {row_kinds(local)[i % local.n_rows] for i in changed}
    assert "closure" in kinds
    assert {i // local.n_rows for i in changed} == {1}
    assert kinds <= {"closure", "dynamics"}


@pytest.mark.slow
@pytest.mark.parametrize("what", ["time_s", "position", "effort", "residual", "length_m"])
def test_a_plan_does_not_depend_on_the_units_of_its_program(what):
    plan = planned("knee-reach")
    problem, guess = plan.problem, guess_from(plan.trajectory)
    scales = choose_scales(problem, guess)
    other = replace(scales, **{what: 1.9 * getattr(scales, what)})
    mesh, durations = uniform(10), np.array([guess.duration_s])
    objectives, motions = [], []
    for units in (scales, other):
        transcribed = transcribe(problem, guess, mesh, durations, scales=units)
        solution = solve(transcribed)
        assert solution.converged
        objectives.append(solution.objective)
        motions.append(trajectory_of(transcribed, solution.x, problem.limits.effort))
    assert objectives[1] == pytest.approx(objectives[0], rel=SAME_MOTION)
    np.testing.assert_allclose(motions[1].position, motions[0].position, atol=SAME_MOTION)
