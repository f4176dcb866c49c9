"""Look for answers that contradict each other: `python -m tests.bench.contradictions [N] [SEED] [--family weak|rotary]`.

weak: four-bars whose effort limit is below the effort that holds their weight. Each is planned for least time, then for
least effort at multiples of that time. Where the machine can wait at rest at the start or the goal, no longer one may be
"infeasible" or cost more than a shorter one and the wait. Below the least time there must be no motion.
rotary: one turn in least time. No answer may be slower than a turn under constant full effort or at constant speed.
"""

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from linkplan.models.errors import LinkplanError
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from tests.support.fourbar import FourBar, Lump

# Durations of the least efforts, as multiples of the least time. Below 1 there must be no motion.
FACTORS = (0.97, 1.0005, 1.002, 1.01, 1.03, 1.1, 1.5)
# Costs that differ by no more than this are equal, relative.
EQUAL_COSTS = 1e-4
# A turn may be slower than the known one by this, relative.
EQUAL_TIMES = 1e-6


def random_fourbar(rng: np.random.Generator, *, crank_turns: bool = False) -> FourBar:
    """Return a random four-bar that closes at crank angle 0; with a crank that turns fully if asked."""
    while True:
        crank, coupler, rocker, ground = rng.uniform((0.06, 0.15, 0.15, 0.15), (0.3, 0.5, 0.5, 0.5))
        tilt = rng.uniform(-np.pi, np.pi)
        lumps = {}
        for name, length in (("crank", crank), ("coupler", coupler), ("rocker", rocker)):
            mass = float(rng.uniform(0.2, 2.0))
            centre = (float(length * rng.uniform(-0.2, 0.2)), float(length * rng.uniform(0.2, 0.8)))
            lumps[name] = (Lump(mass=mass, centre=centre, inertia=float(mass * length**2 * rng.uniform(0.05, 0.3))),)
        fourbar = FourBar(
            crank=float(crank),
            coupler=float(coupler),
            rocker=float(rocker),
            ground=(float(ground * np.cos(tilt)), float(ground * np.sin(tilt))),
            branch=int(rng.choice([-1, 1])),
            lumps=lumps,
        )
        angles = np.linspace(-np.pi, np.pi, 361) if crank_turns else np.zeros(1)
        with np.errstate(invalid="ignore"):
            if np.all(np.nan_to_num(fourbar.transmission(angles)) > 0.25):
                return fourbar


def weak_case(seed: int, number: int) -> tuple[FourBar, float, float, float]:
    """Return a four-bar, its start and goal [rad] and an effort limit [N.m] below the holding torque between them."""
    rng = np.random.default_rng([seed, number, 7])
    while True:
        fourbar = random_fourbar(rng)
        start, way = rng.uniform(-np.pi, np.pi), rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 3.0)
        path = np.linspace(start, start + way, 400)
        with np.errstate(invalid="ignore"):
            clear = np.nan_to_num(fourbar.transmission(path))
        if clear.min() > 0.25:
            holding = np.abs(np.gradient(fourbar.potential(path), path)).max()
            return fourbar, float(start), float(start + way), float(rng.uniform(0.4, 0.95) * holding)


def plan_of(tables: dict) -> dict:
    """Return the status, message, cost, duration and processor time of one problem's answer."""
    begun = time.process_time()
    try:
        plan = plan_motion(Problem.from_tables("contradictions", tables))
        duration = None if plan.trajectory is None or not plan.passed else plan.trajectory.duration_s
        answer = {"status": plan.status, "message": plan.message, "objective": plan.objective, "duration_s": duration}
    except LinkplanError as error:
        answer = {"status": "refused", "message": str(error), "objective": None, "duration_s": None}
    return answer | {"cpu_s": time.process_time() - begun}


def weak_answer(seed: int, number: int, factors: Sequence[float] = FACTORS) -> dict:
    """Return the answers to a weak four-bar's problems, and what contradicts in them."""
    fourbar, start, goal, limit = weak_case(seed, number)

    def tables(minimize: str, duration: float | str) -> dict:
        ends = {"start_deg": {"O": float(np.degrees(start))}, "goal_deg": {"O": float(np.degrees(goal))}}
        return {
            "mechanism": {"model": fourbar.mjcf(start, limit=limit)},
            "motion": {"kind": "reach", **ends, "duration_s": duration},
            "objective": {"minimize": minimize},
        }

    least = plan_of(tables("time", "free"))
    answers, wrong = {"time": least}, []
    if least["duration_s"] is not None:
        near = np.array([start - 1e-5, start + 1e-5, goal - 1e-5, goal + 1e-5])
        potential = fourbar.potential(near)
        hold = min(abs(potential[1] - potential[0]), abs(potential[3] - potential[2])) / 2e-5
        tried = {factor: plan_of(tables("effort", factor * least["duration_s"])) for factor in factors}
        answers |= {str(factor): answer for factor, answer in tried.items()}
        wrong = contradictions(tried, least["duration_s"], hold if hold <= limit else None)
    return {"number": number, "answers": answers, "wrong": wrong}


def contradictions(answers: dict[float, dict], least_s: float, hold: float | None) -> list[str]:
    """Return what contradicts in the answers by factor; `hold` [N.m] holds an end, None where nothing does."""
    wrong, known = [], None
    for factor, answer in answers.items():
        if factor < 1:
            wrong += [] if answer["duration_s"] is None else [f"a motion of {factor} of the least time"]
            continue
        if answer["duration_s"] is None:
            if hold is not None:
                wrong.append(f"{answer['status']} at {factor} of the least time")
            continue
        if known is not None and hold is not None:
            most = known[1] + hold**2 * (factor - known[0]) * least_s
            if answer["objective"] > (1 + EQUAL_COSTS) * most:
                wrong.append(f"cost {answer['objective']:.6g} at {factor}, {known[1]:.6g} at {known[0]}")
        if known is None or answer["objective"] < known[1]:
            known = (factor, answer["objective"])
    return wrong


def turning_case(seed: int, number: int) -> tuple[FourBar, float, float, dict]:
    """Return a four-bar whose crank turns, its effort limit, its damping, and the tables of its turn in least time."""
    rng = np.random.default_rng([seed, number, 8])
    fourbar = random_fourbar(rng, crank_turns=True)
    s = np.linspace(-np.pi, np.pi, 721)
    weight = np.gradient(fourbar.potential(s), s)
    limit = float(10 ** rng.uniform(-0.6, 1.0) * np.abs(weight).max())
    damping = float(rng.uniform(0.01, 0.3) * limit / 10.0)
    model = fourbar.mjcf(0.0, limit=limit).replace('<joint name="O"', f'<joint name="O" damping="{damping}"')
    motion = {"kind": "periodic", "turns": {"O": 1}, "duration_s": "free"}
    return fourbar, limit, damping, {"mechanism": {"model": model}, "motion": motion, "objective": {"minimize": "time"}}


def rotary_answer(seed: int, number: int) -> dict:
    """Return the answer to a turn in least time, the known turns' durations, and what contradicts in them."""
    fourbar, limit, damping, tables = turning_case(seed, number)
    found = plan_of(tables)
    known = {"constant effort": turn_under_full_effort(fourbar, limit, damping)}
    known["constant speed"] = turn_at_constant_speed(fourbar, limit, damping)
    wrong = []
    for name, duration in known.items():
        if duration is not None and (found["duration_s"] is None or found["duration_s"] > (1 + EQUAL_TIMES) * duration):
            wrong.append(f"{found['status']} {found['duration_s']}, {name} takes {duration:.6g} s")
    return {"number": number, "answers": {"time": found, **known}, "wrong": wrong}


def turn_under_full_effort(fourbar: FourBar, limit: float, damping: float) -> float | None:
    """Return the period [s] of the turn under constant full effort, the same energy before and after; None without one."""
    s = np.linspace(0.0, 2 * np.pi, 2001)
    inertia = CubicSpline(s, fourbar.inertia(s))
    slope = CubicSpline(s, fourbar.potential(s)).derivative()

    def turn(energy: float) -> np.ndarray:
        def rate(x: float, y: np.ndarray) -> list[float]:
            speed = np.sqrt(2 * max(y[0], 1e-12) / inertia(x))
            return [limit - damping * speed - slope(x), 1 / speed]

        return solve_ivp(rate, (0.0, 2 * np.pi), [energy, 0.0], rtol=1e-9, atol=1e-12).y[:, -1]

    energies = np.geomspace(1e-3, 1e4, 29) * limit
    gains = [turn(energy)[0] - energy for energy in energies]
    last = max((k for k, gain in enumerate(gains) if gain > 0), default=None)
    if last is None or last + 1 == len(energies):
        return None
    return float(turn(brentq(lambda energy: turn(energy)[0] - energy, energies[last], energies[last + 1]))[1])


def turn_at_constant_speed(fourbar: FourBar, limit: float, damping: float) -> float | None:
    """Return the least period [s] of a turn at constant speed within the effort limit; None where there is none."""
    s = np.linspace(0.0, 2 * np.pi, 4001)
    gradient = np.gradient(fourbar.inertia(s), s) / 2
    weight = np.gradient(fourbar.potential(s), s)
    speeds = np.geomspace(1e-2, 1e3, 2000)
    allowed = [w for w in speeds if np.all(np.abs(gradient * w**2 + weight + damping * w) <= limit)]
    return 2 * np.pi / max(allowed) if allowed else None


def main(arguments: list[str]) -> int:
    """Plan, look for contradictions and sum up; 0 where there are none."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.contradictions", description=__doc__.split(":")[0])
    parser.add_argument("n", nargs="?", type=int, default=100, help="how many problems (100)")
    parser.add_argument("seed", nargs="?", type=int, default=1, help="of the random numbers (1)")
    parser.add_argument("--family", choices=("weak", "rotary"), default="weak")
    asked, wrong = parser.parse_args(arguments), 0
    for number in range(asked.n):
        record = {"weak": weak_answer, "rotary": rotary_answer}[asked.family](asked.seed, number)
        wrong += bool(record["wrong"])
        print(f"number {number}: {'; '.join(record['wrong']) or 'right'}", flush=True)
    print(f"{asked.n} problems, {wrong} with a contradiction")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
