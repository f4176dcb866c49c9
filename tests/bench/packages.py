"""The knee's problems in packages for optimal control: rockit (KU Leuven) and YAPSS, where they are installed.

Each with the closed-form acceleration of `opti_peer` and IPOPT at the same tolerance, in the way that is quickest for it.
"""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.bench.opti_peer import IPOPT, LIMIT, WarmOpti, acceleration_function, build_peer
from tests.bench.timing import GOAL, START

INTERVALS = 40
# The least time's guess [s], as in `build_peer`.
_GUESSED = 0.15


@dataclass(frozen=True, eq=False, slots=True)
class Answer:
    """A peer's answer: its objective, the largest torque [N.m] at nodes and between, and what solves again for a goal."""

    objective: float
    largest: float
    again: Callable[[], Callable[[float], float]]


def by_opti(duration: float | None, *, expand: bool = False) -> Answer:
    """Return the answer of hand-written Opti, built and solved."""
    peer = build_peer(INTERVALS, START, GOAL, duration, expand=expand)
    solution = peer.solve(GOAL)
    torque = np.array(solution.value(peer.effort)).reshape(-1)
    return Answer(float(solution.value(peer.opti.f)), between_nodes(torque), peer.again)


def by_rockit(duration: float | None) -> Answer:
    """Return the answer of rockit, built and solved: Radau collocation of degree 3, torques constant over intervals.

    Quicker than its multiple shooting (`rk`) on both problems, for the same answer; not expanded the first time, as Opti.
    """
    import rockit

    ocp = rockit.Ocp(T=rockit.FreeTime(_GUESSED) if duration is None else duration)
    q, v, u, goal = ocp.state(), ocp.state(), ocp.control(), ocp.parameter()
    ocp.set_der(q, v)
    ocp.set_der(v, acceleration_function()(q, v, u))
    for condition in (ocp.at_t0(q) == START, ocp.at_t0(v) == 0, ocp.at_tf(q) == goal, ocp.at_tf(v) == 0):
        ocp.subject_to(condition)
    ocp.subject_to((u <= LIMIT) >= -LIMIT, include_last=False)
    ocp.add_objective(ocp.T if duration is None else ocp.integral(u**2))
    guessed = _GUESSED if duration is None else duration
    ocp.set_initial(q, START + (GOAL - START) * ocp.t / guessed)
    ocp.set_initial(v, (GOAL - START) / guessed)
    # Of a free duration one trial step leads to where the four-bar does not close; CasADi would say so on every solve.
    ocp.solver("ipopt", IPOPT | {"show_eval_warnings": False})
    ocp.method(rockit.DirectCollocation(N=INTERVALS, degree=3, scheme="radau"))
    ocp.set_value(goal, GOAL)
    solution = ocp.solve()
    _, torque = solution.sample(u, grid="control")

    def again() -> WarmOpti:
        return WarmOpti(ocp._method.opti, goal, ocp.to_function)

    return Answer(float(solution.value(ocp.objective)), float(np.abs(torque).max()), again)


def by_yapss(duration: float | None) -> Answer:
    """Return the answer of YAPSS, built and solved, on its own mesh: ten segments of ten points.

    Its torque between the points is not looked at. It keeps nothing of what it built, and passes no multipliers on: a
    second solve begins at the last answer.
    """
    problem = _yapss_problem(duration)
    solution = problem.solve()

    def again() -> Callable[[float], float]:
        last = solution

        def solve(goal: float) -> float:
            nonlocal last
            problem.guess.from_solution(last)
            state = problem.bounds.phase[0].final_state
            state.lower[0] = state.upper[0] = goal
            last = problem.solve()
            return float(last.objective)

        return solve

    return Answer(float(solution.objective), float(np.abs(solution.phase[0].control).max()), again)


def _yapss_problem(duration: float | None) -> Any:
    import yapss
    from yapss.math.wrapper import SXW

    f = acceleration_function()
    least = duration is None
    problem = yapss.Problem(name="knee", nx=[2], nu=[1], nq=[0 if least else 1])

    def continuous(arg: Any) -> None:
        q, v = arg.phase[0].state
        (u,) = arg.phase[0].control
        # Called with symbols only; CasADi's own are what YAPSS wraps.
        a = [SXW(f(*(symbol._value for symbol in at))) for at in zip(q, v, u, strict=True)]
        arg.phase[0].dynamics[:] = v, np.array(a, dtype=object)
        if not least:
            arg.phase[0].integrand[:] = (u**2,)

    def objective(arg: Any) -> None:
        arg.objective = arg.phase[0].final_time if least else arg.phase[0].integral[0]

    problem.functions.continuous, problem.functions.objective = continuous, objective
    bounds, guess = problem.bounds.phase[0], problem.guess.phase[0]
    bounds.initial_time.lower = bounds.initial_time.upper = 0
    bounds.final_time.lower, bounds.final_time.upper = (0.01, 1.0) if least else (duration, duration)
    bounds.initial_state.lower[:] = bounds.initial_state.upper[:] = START, 0
    bounds.final_state.lower[:] = bounds.final_state.upper[:] = GOAL, 0
    bounds.control.lower[:], bounds.control.upper[:] = -LIMIT, LIMIT
    guessed = _GUESSED if least else duration
    guess.time, guess.control = (0.0, guessed), ((0.0, 0.0),)
    guess.state = (START, GOAL), ((GOAL - START) / guessed,) * 2
    options = problem.ipopt_options
    options.tol, options.print_level, options.sb = IPOPT["ipopt.tol"], 0, "yes"
    return problem


def between_nodes(torque: np.ndarray) -> float:
    """Return the largest size of the quadratics through (node, midpoint, node) values in turn."""
    tau = np.linspace(0, 1, 51)
    left, middle, right = torque[0:-2:2, None], torque[1::2, None], torque[2::2, None]
    curve = left * (1 - tau) * (1 - 2 * tau) + 4 * middle * tau * (1 - tau) + right * tau * (2 * tau - 1)
    return float(np.abs(curve).max())


# Its metadata asks for CasADi 3.7.2 at the most, linkplan for 3.8; with that it works, and pip would refuse the two.
_YAPSS = "not installed: pip install --no-deps yapss; pip install mpmath"
# Every peer: its name, the package that it needs, what to say where that is missing, and how it builds and solves.
PEERS: tuple[tuple[str, str, str, Callable[[float | None], Answer]], ...] = (
    ("Opti", "casadi", "", by_opti),
    ("rockit", "rockit", "not installed: pip install 'linkplan[peers]'", by_rockit),
    ("YAPSS", "yapss", _YAPSS, by_yapss),
)


def installed() -> tuple[dict[str, Callable[[float | None], Answer]], dict[str, str]]:
    """Return the peers that are there, and the names of the others with what to do about it."""
    there = {name: solve for name, package, _, solve in PEERS if importlib.util.find_spec(package) is not None}
    return there, {name: missing for name, _, missing, _ in PEERS if name not in there}
