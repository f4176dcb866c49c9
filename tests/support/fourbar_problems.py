"""Random planning problems of four-bars, with what the phase plane says of each: feasible or not, and the least time."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from tests.support.fourbar import FourBar, Lump
from tests.support.phase_plane import Phase, domain_of, joint_angles, reaches

# The most turns of a chain that gathers way.
_MOST_TURNS = 6
# A verdict is sure where limits so much narrower (for feasible) or wider (for infeasible) give it too.
_SURE = 0.04
# Least transmission (sine) of the poses that a chain may pass, for motions that there surely are and that there are not.
_CLEAR, _BARELY = 0.06, 0.004


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Case:
    """A random problem as a file's tables, and what is known of it.

    `feasible` says whether it has an answer; `duration` [s] is that of its answer where it is known, `shortest` [s] the
    shortest feasible one between its states.
    """

    number: int
    kind: str
    tables: dict
    feasible: bool
    duration: float | None = None
    shortest: float | None = None
    notes: dict = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Drawn:
    """A four-bar loaded, drawn at the start, with the ends of a swing; the largest weight's torque on its way."""

    bare: FourBar
    loaded: FourBar
    payload: dict | None
    start: float
    goal: float
    weight: float
    notes: dict


def _lump(rng: np.random.Generator, length: float, heavy: float = 1.0) -> Lump:
    mass = heavy * rng.uniform(0.2, 2.0)
    centre = (float(length * rng.uniform(-0.2, 0.2)), float(length * rng.uniform(0.2, 0.8)))
    return Lump(mass=float(mass), centre=centre, inertia=float(mass * length**2 * rng.uniform(0.05, 0.3)))


def _draw(rng: np.random.Generator) -> _Drawn:
    """Return a random four-bar and a swing that it can make, some next to a singular pose, some with a full turn."""
    near, turn = rng.random() < 0.12, rng.random() < 0.12
    size = float(rng.choice([0.2, 1.0, 1.0, 1.0, 2.5]))
    while True:
        crank, coupler, rocker, ground = (size * rng.uniform(*ends) for ends in ((0.06, 0.4), *3 * [(0.15, 0.5)]))
        tilt, start = rng.uniform(-np.pi, np.pi, 2)
        far = rng.uniform(np.pi, 2.2 * np.pi) if turn else rng.uniform(0.3, 2.6)
        goal = start + float(rng.choice([-1, 1])) * far
        bare = FourBar(
            crank=float(crank),
            coupler=float(coupler),
            rocker=float(rocker),
            ground=(float(ground * np.cos(tilt)), float(ground * np.sin(tilt))),
            branch=int(rng.choice([-1, 1])),
            lumps={name: (_lump(rng, x),) for name, x in (("crank", crank), ("coupler", coupler), ("rocker", rocker))},
        )
        path = np.linspace(start, goal, 400)
        with np.errstate(invalid="ignore"):
            clear = bare.transmission(path)
        if np.any(np.isnan(clear)) or not (clear.min() > 0.07 if near else clear.min() > 0.25):
            continue
        if near and not clear[0] < 0.2:
            continue
        break
    lengths = sorted([crank, coupler, rocker, ground])
    notes = {
        "near_singular": bool(near),
        "turn": bool(turn),
        "grashof": bool(lengths[0] + lengths[3] < lengths[1] + lengths[2]),
        "branch": bare.branch,
        "size": size,
    }
    loaded, payload = bare, None
    if rng.random() < 0.4:
        link = str(rng.choice(["crank", "coupler", "rocker"]))
        heavy = float(rng.choice([1.0, 1.0, 8.0]))
        lump = _lump(rng, {"crank": crank, "coupler": coupler, "rocker": rocker}[link], heavy)
        loaded = bare.carrying(link, lump)
        payload = {"body": link, "mass_kg": lump.mass, "com_m": [lump.centre[0], 0.0, lump.centre[1]]}
        payload["inertia_kgm2"] = [lump.inertia] * 3
        notes |= {"payload": link, "heavy": heavy > 1}
    weight = float(np.abs(np.gradient(loaded.potential(path), path)).max())
    return _Drawn(
        bare=bare, loaded=loaded, payload=payload, start=float(start), goal=float(goal), weight=weight, notes=notes
    )


def _phase(drawn: _Drawn, low: float, high: float, ranges: dict | None = None, speed=(np.inf,) * 3) -> Phase:
    domain = domain_of(drawn.loaded, drawn.start, _CLEAR, ranges or {})
    return Phase(fourbar=drawn.loaded, low=low, high=high, speed=speed, domain=domain)


def _tables(rng: np.random.Generator, drawn: _Drawn, phase: Phase) -> dict:
    """Return a problem's tables: least time from start to goal, from rest to rest."""
    gear = float(rng.choice([1.0, 2.5, -1.5]))
    effort = sorted([phase.low / gear, phase.high / gear])
    model = drawn.bare.mjcf(drawn.start, gear=gear, limit=10 * max(abs(effort[0]), abs(effort[1])))
    tables = {
        "mechanism": {"model": model} | ({"payload": drawn.payload} if drawn.payload else {}),
        "motion": {
            "kind": "reach",
            "start_deg": {"O": float(np.degrees(drawn.start))},
            "goal_deg": {"O": float(np.degrees(drawn.goal))},
            "duration_s": "free",
        },
        "objective": {"minimize": "time"},
        "limits": {"effort": {"act_O": effort}},
        "solver": {"max_time_s": 900.0},
    }
    speeds = {name: float(np.degrees(x)) for name, x in zip("OAC", phase.speed, strict=True) if np.isfinite(x)}
    if speeds:
        tables["limits"]["speed_deg_s"] = speeds
    return tables


def _strong(rng: np.random.Generator, drawn: _Drawn) -> Phase:
    """Return limits beyond the weight's torque, each its own; some tight, some loose."""
    most = float(rng.choice([1.5, 3.0, 10.0]))
    low, high = drawn.weight * rng.uniform(1.15, most, 2)
    return _phase(drawn, -float(low), float(high))


def _least_time(rng: np.random.Generator, drawn: _Drawn):
    phase = _strong(rng, drawn)
    time, turns = phase.chain(drawn.start, drawn.goal)
    return _tables(rng, drawn, phase), True, {"duration": time, "shortest": time}, {"turns": turns}


def _weak(rng: np.random.Generator, drawn: _Drawn):
    """Torques short of the weight's: swings may gather way, or not be enough."""
    low, high = drawn.weight * rng.uniform(0.2, 1.1, 2)
    phase = _phase(drawn, -float(low), float(high))
    wider = replace(phase.scaled(1 + _SURE), domain=domain_of(drawn.loaded, drawn.start, _BARELY, {}))
    if not reaches(wider, drawn.start, drawn.goal):
        return _tables(rng, drawn, phase), False, {}, {"turns": None}
    sure, _ = phase.scaled(1 - _SURE).chain(drawn.start, drawn.goal, turns=_MOST_TURNS)
    if not np.isfinite(sure):
        return None
    time, turns = phase.chain(drawn.start, drawn.goal, turns=_MOST_TURNS)
    return _tables(rng, drawn, phase), True, {"duration": time, "shortest": time}, {"turns": turns}


def _weak_effort(rng: np.random.Generator, drawn: _Drawn):
    """Torques short of the weight's and least effort within a free duration that the least time leaves room in."""
    found = _weak(rng, drawn)
    if found is None:
        return None
    tables, feasible, times, notes = found
    tables["objective"]["minimize"] = "effort"
    tables["motion"]["max_duration_s"] = 3.0 * times["shortest"] if feasible else 100.0
    return tables, feasible, {"shortest": times.get("shortest")}, notes


def _speed_limited(rng: np.random.Generator, drawn: _Drawn):
    phase = _strong(rng, drawn)
    s = np.linspace(drawn.start, drawn.goal, 2001)
    energy, M = phase.profile(s, 0.0, 0.0)
    w = drawn.loaded.rates(s)
    rates = np.array([w[0], w[1] - w[0], w[2]])
    peak = np.abs(rates * np.sqrt(2 * energy / M)).max(axis=1)
    which = int(rng.integers(3))
    speed = [np.inf] * 3
    speed[which] = float(rng.uniform(0.4, 0.95) * peak[which])
    phase = replace(phase, speed=tuple(speed))
    time, turns = phase.chain(drawn.start, drawn.goal)
    if not np.isfinite(time):
        return None
    tables = _tables(rng, drawn, phase)
    notes = {"turns": turns, "limited": "OAC"[which]}
    if rng.random() < 0.3:
        return _hurried(rng, tables, time, notes)
    return tables, True, {"duration": time, "shortest": time}, notes


def _moving(rng: np.random.Generator, drawn: _Drawn):
    """Speeds at start and goal, some of them backwards or too fast to stop at the goal."""
    phase = _strong(rng, drawn)
    tables = _tables(rng, drawn, phase)
    direct = phase.leg(drawn.start, drawn.goal)
    mean = (drawn.goal - drawn.start) / direct
    va, vb = (float(mean * rng.uniform(-0.7, 1.5)) if rng.random() < 0.7 else 0.0 for _ in range(2))
    tables["motion"]["start_speed_deg_s"] = {"O": float(np.degrees(va))}
    tables["motion"]["goal_speed_deg_s"] = {"O": float(np.degrees(vb))}
    sure, _ = phase.scaled(1 - _SURE).chain(drawn.start, drawn.goal, va, vb, turns=2, n_points=25)
    if not np.isfinite(sure):
        return None
    time, turns = phase.chain(drawn.start, drawn.goal, va, vb, turns=2, n_points=25)
    notes = {"turns": turns, "start_speed": va / mean, "goal_speed": vb / mean}
    choice = rng.random()
    if choice < 0.2:
        return _hurried(rng, tables, time, notes)
    if choice < 0.5 and not turns and phase.can_pause(drawn.start, drawn.goal, va, vb):
        return _unhurried(rng, tables, time, notes, "effort")
    return tables, True, {"duration": time, "shortest": time}, notes


def _hurried(rng: np.random.Generator, tables: dict, time: float, notes: dict):
    """Return a problem of fixed duration that is too short."""
    ratio = float(rng.choice([0.5, 0.8, 0.95, 0.99, 0.999]))
    tables["motion"]["duration_s"] = ratio * time
    tables["objective"]["minimize"] = str(rng.choice(["effort", "effort", "work"]))
    return tables, False, {"shortest": time}, notes | {"ratio": ratio}


def _unhurried(rng: np.random.Generator, tables: dict, time: float, notes: dict, objective, least: float = 1.0):
    """Return a problem of fixed duration that is long enough."""
    ratios = [r for r in (1.0001, 1.001, 1.01, 1.1, 1.3, 2.0, 3.5, 5.0) if r >= least]
    ratio = float(rng.choice(ratios))
    tables["motion"]["duration_s"] = ratio * time
    tables["objective"]["minimize"] = objective
    return tables, True, {"duration": ratio * time, "shortest": time}, notes | {"ratio": ratio}


def _least_effort(rng: np.random.Generator, drawn: _Drawn):
    phase = _strong(rng, drawn)
    time, turns = phase.chain(drawn.start, drawn.goal)
    return _unhurried(rng, _tables(rng, drawn, phase), time, {"turns": turns}, "effort")


def _too_short(rng: np.random.Generator, drawn: _Drawn):
    phase = _strong(rng, drawn)
    time, turns = phase.chain(drawn.start, drawn.goal)
    return _hurried(rng, _tables(rng, drawn, phase), time, {"turns": turns})


def _other_objective(rng: np.random.Generator, drawn: _Drawn):
    """Work, effort's rate and weighted sums, of fixed duration, or free where time is in the sum."""
    phase = _strong(rng, drawn)
    time, turns = phase.chain(drawn.start, drawn.goal)
    tables, notes = _tables(rng, drawn, phase), {"turns": turns}
    torque = max(abs(x) for x in tables["limits"]["effort"]["act_O"])
    share = float(10 ** rng.uniform(-2, 1))
    sums = {
        "work": "work",
        "effort_rate": "effort_rate",
        "effort + effort_rate": {"effort": 1.0, "effort_rate": share * time**2},
        "work + effort": {"work": 1.0, "effort": share * abs(drawn.goal - drawn.start) / (torque * time)},
        "time + effort": {"time": 1.0, "effort": share / torque**2},
        "time + work": {"time": 1.0, "work": share * time / (torque * abs(drawn.goal - drawn.start))},
        "time + effort_rate": {"time": 1.0, "effort_rate": 0.01 * share * time**2 / torque**2},
    }
    name = str(rng.choice(list(sums)))
    notes |= {"objective": name}
    if name.startswith("time"):
        tables["objective"]["minimize"] = sums[name]
        return tables, True, {"shortest": time}, notes
    return _unhurried(rng, tables, time, notes, sums[name], 1.1 if "rate" in name else 1.001)


def _bounded(rng: np.random.Generator, drawn: _Drawn):
    """A free duration within bounds, some of them before the least time."""
    phase = _strong(rng, drawn)
    time, turns = phase.chain(drawn.start, drawn.goal)
    tables, notes = _tables(rng, drawn, phase), {"turns": turns}
    motion = tables["motion"]
    choice = int(rng.integers(4))
    notes |= {"bounds": choice}
    if choice == 0:  # the most comes before the least time
        motion["max_duration_s"] = float(rng.uniform(0.6, 0.995)) * time
        tables["objective"]["minimize"] = str(rng.choice(["time", "effort"]))
        return tables, False, {}, notes
    if choice == 1:  # waiting for the least duration
        motion["min_duration_s"] = float(rng.uniform(1.05, 2.0)) * time
        return tables, True, {"duration": motion["min_duration_s"]}, notes
    motion["max_duration_s"] = float(rng.choice([1.001, 1.05, 1.5, 3.0])) * time
    tables["objective"]["minimize"] = str(rng.choice(["effort", "work"])) if choice == 2 else "time"
    return tables, True, {"shortest": time} | ({"duration": time} if choice == 3 else {}), notes


def _waypoints(rng: np.random.Generator, drawn: _Drawn):
    """A state on the way: at a free or given time, with a speed or without, or beyond the goal."""
    phase = _strong(rng, drawn)
    tables = _tables(rng, drawn, phase)
    a, b = drawn.start, drawn.goal
    choice = int(rng.integers(4))
    via = a + float(rng.uniform(0.2, 0.8)) * (b - a)
    notes: dict = {"waypoint": choice}
    waypoint: dict = {"at_deg": {"O": float(np.degrees(via))}}
    tables["motion"]["waypoints"] = [waypoint]
    if choice == 0:  # passed anyway
        time, _ = phase.chain(a, b)
        return tables, True, {"duration": time, "shortest": time}, notes
    if choice == 1:  # with a speed that is not the fastest motion's
        speed = float(rng.uniform(0.2, 1.2)) * (b - a) / phase.leg(a, b)
        waypoint["speed_deg_s"] = {"O": float(np.degrees(speed))}
        time = phase.chain(a, via, 0.0, speed)[0] + phase.chain(via, b, speed, 0.0)[0]
        direct = phase.scaled(1 - _SURE)
        sure = np.isfinite(direct.leg(a, via, 0.0, speed) + direct.leg(via, b, speed, 0.0))
        return (tables, True, {"duration": time, "shortest": time}, notes) if sure else None
    if choice == 2:  # at its time, at rest there or not
        first, second = phase.leg(a, via), phase.leg(via, b)
        waypoint["time_s"] = float(rng.uniform(1.05, 2.0)) * first
        tables["motion"]["duration_s"] = waypoint["time_s"] + float(rng.uniform(1.05, 2.0)) * second
        tables["objective"]["minimize"] = "effort"
        return tables, True, {"duration": tables["motion"]["duration_s"]}, notes
    beyond = b + float(rng.uniform(0.1, 0.5)) * np.sign(b - a)
    if not phase.domain[0] < beyond < phase.domain[1]:
        return None
    weight = np.gradient(drawn.loaded.potential(s := np.linspace(b, beyond, 200)), s)
    if not np.all((weight > 0.9 * phase.low) & (weight < 0.9 * phase.high)):
        return None
    waypoint["at_deg"] = {"O": float(np.degrees(beyond))}
    past = replace(phase, domain=(beyond, phase.domain[1]) if b > a else (phase.domain[0], beyond))
    straight = phase.leg(a, beyond) + phase.leg(beyond, b)
    turns = [phase.leg(a, p) + phase.leg(p, b) for p in np.linspace(beyond, past.domain[1 if b > a else 0], 25)[1:]]
    if min(turns) < straight:
        return None
    return tables, True, {"duration": straight, "shortest": straight}, notes


def _ranges(rng: np.random.Generator, drawn: _Drawn):
    """A range of a joint that follows: just wide enough, or left on the way."""
    phase = _strong(rng, drawn)
    s = np.linspace(drawn.start, drawn.goal, 4001)
    joint = str(rng.choice(["A", "C"]))
    angle = joint_angles(drawn.loaded, s)[joint]
    low, high = float(angle.min()), float(angle.max())
    inside = max(angle[0], angle[-1]), min(angle[0], angle[-1])
    left = [x for x, ends in ((high, high - inside[0]), (low, inside[1] - low)) if ends > 0.03]
    tables = _tables(rng, drawn, phase)
    if left and rng.random() < 0.6:  # the path turns back on the way: its turn is beyond the range
        over = left[0]
        ends = [low - 0.2, over - 0.01] if over == high else [over + 0.01, high + 0.2]
        tables["limits"]["range_deg"] = {joint: [float(np.degrees(x)) for x in ends]}
        return tables, False, {}, {"range": joint}
    slack = float(rng.choice([1e-3, 0.02, 0.3]))
    ranges = {joint: (low - slack, high + slack)}
    tables["limits"]["range_deg"] = {joint: [float(np.degrees(x)) for x in ranges[joint]]}
    phase = replace(phase, domain=domain_of(drawn.loaded, drawn.start, _CLEAR, ranges))
    time, turns = phase.chain(drawn.start, drawn.goal)
    notes = {"turns": turns, "range": joint, "slack": slack}
    if rng.random() < 0.5:
        return _unhurried(rng, tables, time, notes, "effort")
    return tables, True, {"duration": time, "shortest": time}, notes


# Kinds of problems with their shares.
KINDS: dict[str, tuple[float, Callable]] = {
    "least time": (0.18, _least_time),
    "weak": (0.10, _weak),
    "weak, least effort": (0.04, _weak_effort),
    "speed limit": (0.08, _speed_limited),
    "moving ends": (0.10, _moving),
    "least effort": (0.16, _least_effort),
    "too short": (0.08, _too_short),
    "other objective": (0.10, _other_objective),
    "bounded duration": (0.05, _bounded),
    "waypoint": (0.06, _waypoints),
    "range": (0.05, _ranges),
}


def kind_of(seed: int, number: int) -> str:
    """Return the kind of a random problem."""
    return _drawn_kind(np.random.default_rng([seed, number]))


def _drawn_kind(rng: np.random.Generator) -> str:
    return str(rng.choice(list(KINDS), p=[share for share, _ in KINDS.values()]))


def random_case(seed: int, number: int) -> Case:
    """Return a random problem, the same for the same seed and number."""
    rng = np.random.default_rng([seed, number])
    kind = _drawn_kind(rng)
    while True:
        drawn = _draw(rng)
        found = KINDS[kind][1](rng, drawn)
        if found is None:
            continue
        tables, feasible, times, notes = found
        return Case(number=number, kind=kind, tables=tables, feasible=feasible, notes=drawn.notes | notes, **times)
