"""A mechanism's planning problem as a formulation: which functions it needs, and the numbers of its limits and objective."""

import numpy as np

from linkplan.planner.closed_chain.force_rows import force_rows_of
from linkplan.planner.closed_chain.lifted import n_lifted
from linkplan.planner.closed_chain.mechanics import (
    RUNNING,
    WITH_EFFORT,
    NodeTerms,
    Scales,
    control_unit,
    mechanism_system,
    n_algebraic,
    node_numbers,
)
from linkplan.planner.closed_chain.power_rows import own_column, power_rows_of
from linkplan.planner.closed_chain.site_rows import coordinate_key, coordinate_row, site_bounds, site_endpoint
from linkplan.planner.problem.objective import QUADRATIC, Objective
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.refinement.tightening import Tightening, tightening_over
from linkplan.planner.transcription.formulation import Formulation, PhaseBoundary, Units
from linkplan.planner.transcription.interval import IntervalRows

# Weight of the squared effort rate where no other term makes the effort smooth (tracking, work), all in scaled units. Where
# limits bind, the motion nearest in position alone chatters at the ends of its bang arcs (Fuller's phenomenon); with this
# weight, a swing over the whole limit in a tenth of the motion costs as much as an rms error of 3e-4 of the motion's span.
SMOOTHING = 2.5e-9


def formulate(
    problem: PlanningProblem,
    scales: Scales,
    *,
    position_rows: bool = False,
    enclosed: bool = False,
    least_limit: bool = False,
    tightenings: tuple[Tightening, ...] = (),
    smoothing: float = SMOOTHING,
) -> Formulation:
    """Return a problem's formulation.

    Args:
        problem: what to plan.
        scales: units of its unknowns.
        position_rows: whether independent ranges are kept between the nodes by constraint rows.
        enclosed: whether limits on power and pin force are kept between the nodes by constraint rows.
        least_limit: leave the objective out: only a motion is sought.
        tightenings: how far limits are tightened over the motion, where it overran them between nodes.
        smoothing: the weight of the squared effort rate where nothing else makes the effort smooth, in scaled units.
    """
    mechanism, limits, objective = problem.mechanism, problem.limits, problem.objective
    n_s, n_u = mechanism.dof, mechanism.n_u
    speed_columns, speed_joints = _speed_limited(problem)
    motor_columns, motors = _motors_limited(problem)
    powers = power_rows_of(problem, everywhere=enclosed)
    forces = force_rows_of(problem, everywhere=enclosed)
    running = () if least_limit else tuple(term for term in RUNNING if objective.has(term))
    smoothed = is_smoothed(objective)
    rated = tuple(int(j) for j in np.flatnonzero(np.isfinite(limits.effort_rate).any(axis=1)))
    costs = () if least_limit else _costs(problem, smoothed)
    passed = sorted({(site, axis) for w in problem.motion.waypoints for site, axis, _ in w.open_coordinates})
    asked = NodeTerms(
        running=running,
        speed_joints=speed_joints,
        motors=motors,
        powers=powers.at_nodes,
        levers=powers.levers,
        closures=forces.at_nodes,
        bearing=forces.closures,
        singular=mechanism.dynamics.block_singularity.numel_out(0) if limits.singular_margin > 0 else 0,
        controls=tuple(j for j, actuator in enumerate(mechanism.actuators) if actuator.limits_control),
        tendons=tuple(range(len(mechanism.tendons))),
        sites=(*(limit.key for limit in limits.site), *(coordinate_key(*where) for where in passed)),
        corners=problem.robust.corners,
        n_u=n_u,
    )
    works = "work" in running
    n_further = len(powers.levers) + forces.n_unknowns
    n_z = n_algebraic(mechanism, works=works, others=n_further)
    rows = IntervalRows(
        costs=costs,
        speed_columns=speed_columns,
        position_columns=tuple(range(n_s)) if position_rows else (),
        rate_columns=rated,
        motor_columns=motor_columns,
        power_columns=powers.columns,
        power_levers=powers.of_levers(n_z - n_further),
        squared_sums=forces.unknowns(n_z - forces.n_unknowns),
        open_end_path=tuple(i for i, kind in enumerate(asked.kinds) if kind in WITH_EFFORT),
    )
    unit = _term_units(problem, scales)
    value = sum(weight * unit[term] for term, weight in objective.weights.items())
    weights = [objective.weight(term) * unit[term] / value for term in running]
    lines = np.array([_line(problem, j) for j in asked.motors]).reshape(-1, 2)
    before, after = node_numbers(mechanism, asked, scales, weights, lines, limits.closure_force)
    tracked = "tracking" in running

    def theta(times: np.ndarray) -> np.ndarray:
        n, m = times.shape
        parts = [np.broadcast_to(before, (n, m, len(before)))]
        if tracked:
            parts.append(problem.reference.derivative(times.ravel()).reshape(n, m, n_s) / scales.position)
        return np.concatenate([*parts, np.broadcast_to(after, (n, m, len(after)))], axis=2)

    rate = scales.position / scales.time_s
    independent, dependent = mechanism.independent, mechanism.dependent
    algebraic = [limits.position[dependent], np.tile([-np.inf, np.inf], (n_lifted(mechanism), 1))]
    algebraic += [np.tile([0.0, np.inf], (n_u if works else 0, 1)), np.tile([-np.inf, np.inf], (n_further, 1))]
    algebraic = np.vstack(algebraic)
    own = {
        "speed": limits.speed[independent[list(speed_columns)]] / rate[list(speed_columns), None],
        "position": limits.position[independent] / scales.position[:, None],
        "effort_rate": limits.effort_rate[list(rated)] * scales.time_s / scales.effort[list(rated), None],
        "motor": np.tile([-1.0, 1.0], (len(motor_columns), 1)),
        "power": powers.bounds(problem, scales),
        "closure_force": forces.bounds(),
    }
    limited = [("speed", joint) for joint in speed_joints] + [("motor", j) for j in motors]
    limited += [("power", j) for j in asked.powers] + [("closure_force", c) for c in asked.closures]
    limited += [("singular_margin", block) for block in range(asked.singular)]
    limited += [("control", j) for j in asked.controls]
    of_tendons = [("tendon", item) for item in asked.tendons]
    of_sites = [("tube" if limit.is_tube else "site", item) for item, limit in enumerate(limits.site)]
    limited += of_tendons + [("robust", item) for item in range(len(asked.corners) * n_u)]
    limited += of_sites + [("passed", k) for k in range(len(passed))]
    limited += [("work", j) for j in range(n_u if works else 0)]
    path = [
        limits.speed[list(speed_joints)] * scales.time_s,
        np.tile([-1.0, 1.0], (len(motors), 1)),
        limits.power[list(asked.powers)] / scales.power,
        np.tile([-np.inf, 1.0], (len(asked.closures), 1)),
        np.tile([limits.singular_margin, np.inf], (asked.singular, 1)),
        np.array([_control_range(problem, j) for j in asked.controls]),
        np.array([[tendon.low / tendon.span, tendon.high / tendon.span] for tendon in mechanism.tendons]),
        np.tile(problem.robust.room * limits.effort / scales.effort[:, None], (len(asked.corners), 1)),
        np.array([site_bounds(mechanism, limit) for limit in limits.site]),
        np.tile([-np.inf, np.inf], (len(passed), 1)),
        np.tile([0.0, np.inf], (n_u if works else 0, 1)),
    ]
    path = np.vstack([part.reshape(-1, 2) for part in path])
    state = np.vstack([limits.position[independent] / scales.position[:, None], limits.speed[independent] / rate[:, None]])
    of_own = {
        rows[0][0]: tightening_over(tightenings, rows, own[rows[0][0]]) for rows in (powers.items, forces.items) if rows
    }
    endpoint, places = site_endpoint(problem, scales.position, n_z)
    adrift = tuple(np.flatnonzero(problem.goes_on).tolist())
    returns = tuple(i for i in range(2 * n_s) if i not in adrift)
    return Formulation(
        build_system=lambda: mechanism_system(mechanism, asked),
        n_s=n_s,
        n_x=0,
        n_z=n_z,
        n_u=n_u,
        rows=rows,
        units=Units(
            time_s=scales.time_s,
            state=np.concatenate([scales.position, rate]),
            effort=scales.effort,
            objective=value,
        ),
        state=state,
        algebraic=algebraic,
        effort=limits.effort,
        path=path,
        own=own,
        boundaries=phase_boundaries_of(problem, scales),
        returns=returns if problem.motion.kind == "periodic" else (),
        adrift=adrift if problem.motion.kind == "periodic" else (),
        advance=_advance(problem, scales, returns),
        smooth=smoothed or objective.has("effort_rate") or bool(rated),
        eta=_eta(
            problem,
            scales,
            rows,
            value,
            smoothing if smoothed else 0.0,
            lines=_own_lines(problem, motor_columns, scales),
        ),
        theta=theta,
        tightening=tightening_over(tightenings, limited, path),
        own_tightening={kind: of_kind for kind, of_kind in of_own.items() if of_kind is not None},
        position_path=tuple(limited.index(row) for row in of_tendons + of_sites),
        passed=tuple(
            (k + 1, limited.index(("passed", passed.index((site, axis)))), coordinate_row(mechanism, site, axis, value))
            for k, waypoint in enumerate(problem.motion.waypoints)
            for site, axis, value in waypoint.open_coordinates
        ),
        endpoint=endpoint,
        endpoint_bounds=np.zeros((len(places), 2)),
        endpoint_parameters=places,
    )


def _advance(problem: PlanningProblem, scales: Scales, returns: tuple[int, ...]) -> np.ndarray | float:
    """Return by how much the states `returns` of a periodic motion have gone on at its end, scaled; 0 where they return."""
    if problem.motion.turns is None:
        return 0.0
    return np.concatenate([problem.motion.advance / scales.position, np.zeros(problem.mechanism.dof)])[list(returns)]


def is_smoothed(objective: Objective) -> bool:
    """Return whether a weight on the squared effort rate stands beside an objective: alone it lets efforts chatter."""
    return objective.has("tracking", "work") and not objective.has(*QUADRATIC)


def _control_range(problem: PlanningProblem, j: int) -> tuple[float, float]:
    """Return a servo's ctrlrange in the program's unit."""
    actuator, unit = problem.mechanism.actuators[j], control_unit(problem.mechanism, j)
    return actuator.control_lower / unit, actuator.control_upper / unit


def _speed_limited(problem: PlanningProblem) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the independent columns and the dependent joints whose speeds are limited."""
    mechanism = problem.mechanism
    limited = [i for i in range(mechanism.n_q) if np.any(np.isfinite(problem.limits.speed[i]))]
    columns = tuple(k for k, i in enumerate(mechanism.independent) if i in limited)
    return columns, tuple(i for i in limited if i not in mechanism.independent)


def _motors_limited(problem: PlanningProblem) -> tuple[tuple[tuple[int, int], ...], tuple[int, ...]]:
    """Return (effort, coordinate) of motors whose speed is a coordinate's own, and the other motors with a line.

    The former's lines are bounded at every instant, the latter's at nodes.
    """
    columns, others = [], []
    for j, motor in enumerate(problem.motors):
        if motor is not None and motor.has_line:
            column = own_column(problem.mechanism, j)
            if column is None:
                others.append(j)
            else:
                columns.append((j, column))
    return tuple(columns), tuple(others)


def _line(problem: PlanningProblem, j: int) -> tuple[float, float]:
    motor = problem.motors[j]
    return 1.0 / motor.stall_effort, 1.0 / motor.no_load_speed


def _own_lines(problem: PlanningProblem, columns: tuple[tuple[int, int], ...], scales: Scales) -> np.ndarray:
    """Return alpha and beta of each motor on a coordinate, scaled, its gear in beta."""
    lines = []
    for j, column in columns:
        alpha, beta = _line(problem, j)
        gear = problem.mechanism.actuators[j].gear
        lines += [alpha * scales.effort[j], beta * gear * scales.position[column] / scales.time_s]
    return np.array(lines)


def _costs(problem: PlanningProblem, smoothed: bool) -> tuple[str, ...]:
    objective = problem.objective
    present = {
        "time": objective.has("time"),
        "effort": objective.has("effort", "copper_loss"),
        "effort_rate": objective.has("effort_rate") or smoothed,
    }
    return tuple(cost for cost, there in present.items() if there)


def _losses(problem: PlanningProblem) -> np.ndarray:
    return np.array([0.0 if motor is None else motor.loss for motor in problem.motors])


def _term_units(problem: PlanningProblem, scales: Scales) -> dict[str, float]:
    """Return each term's unit in SI: what it is where its scaled integrand is one."""
    T, U, P = scales.time_s, float(scales.effort.max()), float(scales.position.max())
    loss = float((_losses(problem) * scales.effort**2).max(initial=0.0))
    units = {"time": T, "effort": T * U**2, "tracking": T * P**2, "work": T * scales.power, "copper_loss": T * loss}
    return units | {"effort_rate": U**2 / T, "closure_force": T * scales.force**2}


def _eta(
    problem: PlanningProblem, scales: Scales, rows: IntervalRows, value: float, smoothing: float, lines: np.ndarray
) -> np.ndarray:
    """Return an interval's own parameters: weights of its costs on the scaled unknowns, then the motors' lines."""
    objective, T = problem.objective, scales.time_s
    squared = scales.effort**2
    numbers = {
        "time": np.array([objective.weight("time") * T]),
        "effort": T * squared * (objective.weight("effort") + objective.weight("copper_loss") * _losses(problem)),
        "effort_rate": objective.weight("effort_rate") * squared / T + smoothing * value,
    }
    return np.concatenate([*(numbers[cost] / value for cost in rows.costs), lines])


def phase_boundaries_of(problem: PlanningProblem, scales: Scales) -> tuple[PhaseBoundary, ...]:
    """Return the phase boundaries, scaled: start, the middle of a periodic motion between two poses, waypoints, goal."""
    motion, n_s = problem.motion, problem.mechanism.dof
    unit = np.concatenate([scales.position, scales.position / scales.time_s])

    def boundary(s, v, time: tuple[float, float], share: float | None = None, adrift=False) -> PhaseBoundary:
        state = np.full((2 * n_s, 2), [-np.inf, np.inf])
        for value, place in ((s, slice(0, n_s)), (v, slice(n_s, None))):
            if value is not None:
                asked = np.asarray(value, dtype=float) / unit[place]
                given = ~np.isnan(asked) & ~(problem.adrift & adrift)
                state[place][given] = asked[given, None]
        return PhaseBoundary(state=state, time=(time[0] / scales.time_s, time[1] / scales.time_s), share=share)

    if motion.duration_s is not None:
        last = (motion.duration_s, motion.duration_s)
    else:
        last = (motion.min_duration_s or 0.0, motion.max_duration_s or np.inf)
    via = []
    for waypoint in motion.waypoints:
        time = (0.0, np.inf) if waypoint.time_s is None else (waypoint.time_s, waypoint.time_s)
        via.append(boundary(waypoint.position, waypoint.speed, time))
    if motion.kind == "reach":
        rest = np.zeros(n_s)
        start = boundary(motion.start, rest if motion.start_speed is None else motion.start_speed, (0.0, 0.0))
        position, speed = (None if motion.goal_is_free else motion.goal), motion.goal_speed
        goal = boundary(position, rest if speed is None else speed, last, adrift=True)
        return (start, *via, goal)
    start, goal = boundary(_first_position(problem), None, (0.0, 0.0)), boundary(None, None, last)
    if motion.goal is not None and not via:
        via = [boundary(motion.goal, None, (0.0, np.inf), share=0.5, adrift=True)]
    return (start, *via, goal)


def _first_position(problem: PlanningProblem) -> np.ndarray | None:
    """Return the positions (n_s,) in which a periodic motion begins, NaN where they are free; None where all are.

    A motion that turns for ever passes every angle, and begun at any of them it is as good: it begins at home's. So does a
    spin on which nothing depends.
    """
    motion = problem.motion
    home = problem.mechanism.home[problem.mechanism.independent]
    if motion.start is not None or not (np.any(problem.goes_on) or (motion.turns is not None and not motion.waypoints)):
        return motion.start
    first = np.where(problem.goes_on, home, np.nan)
    if motion.turns is not None and not motion.waypoints:
        column = int(np.flatnonzero(motion.turns)[0])
        first[column] = home[column]
    return first
