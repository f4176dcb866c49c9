"""Small robots of two to sixteen motors with problems from rest to rest over about half of their joints' ranges.

Motors of arms and chains hold the weight with about half of their limits at most, those of legs with less. `write_robots`
fills a folder with NAME.xml and NAME-KIND.toml: `python -m tests.bench.many_robots FOLDER`.
"""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

Point = Sequence[float]
KINDS = ("time", "effort11", "effort15", "payload", "speed", "mixed")
# Durations of a least effort, of about the least time; the largest speed, of the mean one in that time.
_LONGER = {"effort11": 1.1, "effort15": 1.5}
_SPEED_SHARE = 1.4
# Of the mixed objective's value, about the part of effort where all motors give their limits in least time.
_EFFORT_PART = 0.5
_GRAVITY = 9.81


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Robot:
    """A robot: its MJCF and a motion from rest to rest between two poses [deg] of its motors' joints."""

    name: str
    text: str
    start_deg: dict[str, float]
    goal_deg: dict[str, float]
    limits: dict[str, float]  # [N.m] of each motor's joint
    payload: tuple[str, float]  # body and mass [kg]
    least_time_s: float  # about: by `tests.bench.many_peer`

    @property
    def n_motors(self) -> int:
        """The number of motors, which is the number of freedoms too."""
        return len(self.limits)

    def problem(self, kind: str) -> str:
        """Return the text of a problem file."""
        free, body, mass = kind not in _LONGER, *self.payload
        duration = '"free"' if free else f"{_LONGER[kind] * self.least_time_s:.6g}"
        effort = _EFFORT_PART / sum(limit**2 for limit in self.limits.values())
        objective = {"mixed": f"{{ time = 1.0, effort = {effort:.6g} }}"}.get(kind, '"time"' if free else '"effort"')
        inertia = "com_m = [0.0, 0.0, 0.0], inertia_kgm2 = [1e-3, 1e-3, 1e-3]"
        speeds = {n: _SPEED_SHARE * abs(self.goal_deg[n] - a) / self.least_time_s for n, a in self.start_deg.items()}
        lines = ["[mechanism]", f'model = "{self.name}.xml"']
        if kind == "payload":
            lines.append(f'payload = {{ body = "{body}", mass_kg = {mass}, {inertia} }}')
        ends = [f"start_deg = {_table(self.start_deg)}", f"goal_deg = {_table(self.goal_deg)}"]
        lines += ["[motion]", 'kind = "reach"', *ends]
        lines += [f"duration_s = {duration}", "[objective]", f"minimize = {objective}", "[limits]", 'contacts = "note"']
        if kind == "speed":
            lines.append(f"speed_deg_s = {_table(speeds)}")
        return "\n".join([*lines, "[mesh]", "intervals = 40", "[solver]", "max_time_s = 60", ""])


def _table(values: dict[str, float]) -> str:
    return "{ " + ", ".join(f"{name} = {value:.6g}" for name, value in values.items()) + " }"


def _text(values: Iterable[float]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _link(name: str, at: Point, joint: str, end: Point, mass: float, *inside: str) -> str:
    """Return a body at a place of its parent, with a joint and a rod from its origin to `end` [m]."""
    radius = max(0.006, 0.02 * mass ** (1 / 3))
    rod = f'<geom type="capsule" fromto="0 0 0 {_text(end)}" size="{radius:.3g}" mass="{mass}"/>'
    return f'<body name="{name}" pos="{_text(at)}">{joint}{rod}{"".join(inside)}</body>'


def _hinge(name: str, axis: str, reach_deg: float = 0.0, armature: float = 0.02) -> str:
    """Return a motor's or an output's hinge with a range, or a rod's, which is nearly without friction."""
    along = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}.get(axis, axis)
    kept = f'range="{-reach_deg} {reach_deg}" armature="{armature}"' if reach_deg else 'damping="0.002" armature="0"'
    return f'<joint name="{name}" axis="{along}" {kept}/>'


def _site(name: str, at: Point) -> str:
    return f'<site name="{name}" pos="{_text(at)}"/>'


def _mjcf(name: str, bodies: str, limits: dict[str, float], pins: Sequence[tuple[str, str]] = ()) -> str:
    motors = "".join(f'<motor name="m_{j}" joint="{j}" ctrlrange="{-u:.6g} {u:.6g}"/>' for j, u in limits.items())
    connects = "".join(f'<connect site1="{first}" site2="{second}"/>' for first, second in pins)
    return f"""<mujoco model="{name}">
  <compiler angle="degree" autolimits="true"/>
  <option timestep="0.0005" integrator="implicitfast"><flag contact="disable"/></option>
  <default><joint damping="0.05"/></default>
  <worldbody>{bodies}</worldbody>
  <equality>{connects}</equality>
  <actuator>{motors}</actuator>
</mujoco>
"""


def _robot(
    name: str,
    bodies: str,
    motors: dict[str, tuple[float, float, float]],
    payload: tuple[str, float],
    pins: Sequence[tuple[str, str]] = (),
) -> Robot:
    """Return a robot of `motors`, which are start [deg], goal [deg] and limit [N.m] by joint."""
    start, goal, limits = ({joint: row[k] for joint, row in motors.items()} for k in range(3))
    text = _mjcf(name, bodies, limits, pins)
    time_s = LEAST_TIMES_S[name]
    return Robot(name=name, text=text, start_deg=start, goal_deg=goal, limits=limits, payload=payload, least_time_s=time_s)


def five_bar() -> Robot:
    """Return a five-bar in a vertical plane, its tip over two motors."""
    left = _link("rod_l", (-0.15, 0, 0.16), _hinge("elbow_l", "y"), (0.25, 0, 0.24), 0.3, _site("tip_l", (0.25, 0, 0.24)))
    right = _link("rod_r", (0.15, 0, 0.16), _hinge("elbow_r", "y"), (-0.25, 0, 0.24), 0.3, _site("tip_r", (-0.25, 0, 0.24)))
    bodies = _link("crank_l", (-0.1, 0, 0), _hinge("left", "y", 60), (-0.15, 0, 0.16), 0.5, left)
    bodies += _link("crank_r", (0.1, 0, 0), _hinge("right", "y", 60), (0.15, 0, 0.16), 0.5, right)
    motors = {"left": (-20.0, 40.0, 8.0), "right": (-25.0, 30.0, 8.0)}
    return _robot("five-bar-reach", bodies, motors, ("rod_l", 0.3), [("tip_l", "tip_r")])


def _knee(*below: str) -> tuple[str, tuple[str, str]]:
    """Return lever, rod and shank of a knee driven by a four-bar, to stand in a thigh, and the pin that closes it."""
    rod = _link("rod", (0.06, 0, 0), _hinge("rod_pin", "y"), (-0.01, 0, -0.3), 0.2, _site("rod_end", (-0.01, 0, -0.3)))
    tab = _site("tab", (0.05, 0.04, 0.01))
    lever = _link("lever", (0, 0.04, -0.05), _hinge("knee_motor", "y", 65), (0.06, 0, 0), 0.25, rod)
    shank = _link("shank", (0, 0, -0.36), _hinge("knee", "y", 110, 0.001), (0, 0, -0.36), 2.5, tab, *below)
    return lever + shank, ("rod_end", "tab")


def knee_leg() -> Robot:
    """Return a leg of two motors: hip, and knee by a lever on the thigh and a rod."""
    inside, pin = _knee()
    bodies = _link("thigh", (0, 0, 1), _hinge("hip", "y", 80), (0, 0, -0.36), 4.5, inside)
    motors = {"hip": (25.0, -50.0, 80.0), "knee_motor": (-10.0, 50.0, 60.0)}
    return _robot("knee-leg", bodies, motors, ("shank", 1.0), [pin])


def _ankle() -> tuple[str, list[tuple[str, str]]]:
    """Return two cranks, their rods and a foot that pitches and rolls, to stand in a shank, and the rods' pins."""
    sides, tabs = "", ""
    for name, y in (("l", 0.045), ("r", -0.045)):
        end = (0, 0, -0.26)
        rod = _link(f"rod_{name}", (0, 0, 0), _hinge(f"roll_{name}", "x"), end, 0.1, _site(f"end_{name}", end))
        cross = _link(f"cross_{name}", (-0.05, 0, 0), _hinge(f"pitch_{name}", "y"), (0, 0, -0.01), 0.02, rod)
        sides += _link(f"crank_{name}", (0, y, -0.09), _hinge(f"ankle_{name}", "y", 60), (-0.05, 0, 0), 0.15, cross)
        tabs += _site(f"tab_{name}", (-0.05, y, 0.01))
    foot = _link("foot", (0, 0, 0), _hinge("ankle_roll", "x", 40, 0.001), (0.12, 0, -0.05), 0.9, tabs)
    cross = _link("cross", (0, 0, -0.36), _hinge("ankle_pitch", "y", 70, 0.001), (0, 0.01, 0), 0.05, foot)
    return sides + cross, [("end_l", "tab_l"), ("end_r", "tab_r")]


def rod_ankle() -> Robot:
    """Return an ankle with two rods on ball joints between cranks and foot."""
    inside, pins = _ankle()
    shank = f'<body name="shank" pos="0 0 0.5"><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>{inside}</body>'
    motors = {"ankle_l": (25.0, -30.0, 6.0), "ankle_r": (20.0, -35.0, 6.0)}
    return _robot("rod-ankle", shank, motors, ("foot", 0.3), pins)


def arm_three() -> Robot:
    """Return an arm of three joints: base, shoulder, elbow."""
    lower = _link("lower", (0, 0, 0.3), _hinge("elbow", "y", 130, 0.05), (0, 0, 0.3), 1.5)
    upper = _link("upper", (0, 0, 0.15), _hinge("shoulder", "y", 100, 0.1), (0, 0, 0.3), 3.0, lower)
    bodies = _link("base", (0, 0, 0), _hinge("base", "z", 170, 0.1), (0, 0, 0.15), 4.0, upper)
    motors = {"base": (-80.0, 80.0, 25.0), "shoulder": (-50.0, 50.0, 22.0), "elbow": (70.0, -60.0, 5.0)}
    return _robot("arm-three", bodies, motors, ("lower", 0.5))


def delta() -> Robot:
    """Return a delta robot: three arms, each with a rod on ball joints, and a platform that does not turn."""
    bodies, sites, pins = "", "", []
    reach = (-0.35, 0, -0.35)
    for k in range(3):
        side = _hinge(f"side_{k}", "-1 0 1")
        rod = _link(f"rod_{k}", (0, 0, 0), side, reach, 0.1, _site(f"end_{k}", reach))
        cross = _link(f"cross_{k}", (0.2, 0, 0), _hinge(f"elbow_{k}", "y"), (0, 0.01, 0), 0.02, rod)
        arm = _link(f"arm_{k}", (0.2, 0, 0), _hinge(f"arm_{k}", "y", 60, 0.005), (0.2, 0, 0), 0.3, cross)
        bodies += f'<body euler="0 0 {120 * k}" pos="0 0 0.8">{arm}</body>'
        sites += _site(f"at_{k}", (0.05 * np.cos(2 * np.pi * k / 3), 0.05 * np.sin(2 * np.pi * k / 3), 0))
        pins.append((f"end_{k}", f"at_{k}"))
    slides = "".join(f'<joint name="{n}" type="slide" axis="{a}" damping="0.1"/>' for n, a in _AXES.items())
    bodies += _link("platform", (0, 0, 0.45), slides, (0, 0.01, 0), 0.5, sites)
    motors = {"arm_0": (-20.0, 40.0, 6.0), "arm_1": (-25.0, 30.0, 6.0), "arm_2": (-15.0, 45.0, 6.0)}
    return _robot("delta-reach", bodies, motors, ("platform", 0.3), pins)


_AXES = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}


def leg_six() -> Robot:
    """Return a humanoid's leg of six motors: three in the hip, a knee by a four-bar, an ankle by two rods."""
    ankle, pins = _ankle()
    inside, pin = _knee(ankle)
    thigh = _link("thigh", (0, 0, 0), _hinge("hip_pitch", "y", 90), (0, 0, -0.36), 4.5, inside)
    roll = _link("hip_roll", (0, 0, -0.05), _hinge("hip_roll", "x", 40), (0.04, 0, 0), 1.0, thigh)
    bodies = _link("hip_yaw", (0, 0, 1), _hinge("hip_yaw", "z", 50), (0, 0, -0.05), 1.0, roll)
    motors = {
        "hip_yaw": (-25.0, 25.0, 50.0),
        "hip_roll": (-15.0, 20.0, 80.0),
        "hip_pitch": (25.0, -45.0, 110.0),
        "knee_motor": (-10.0, 50.0, 80.0),
        "ankle_l": (25.0, -30.0, 20.0),
        "ankle_r": (20.0, -35.0, 20.0),
    }
    return _robot("leg-six", bodies, motors, ("foot", 0.5), [pin, *pins])


def two_arms() -> Robot:
    """Return two arms of five motors on one torso, mirrored; the right one moves the other way."""
    bodies, motors = "", {}
    rows = (("pitch", "y", 120, 40.0, -50.0, 45.0), ("roll", "x", 90, 45.0, 10.0, 60.0), ("yaw", "z", 90, 15.0, -40.0, 45.0))
    rows += (("elbow", "y", 120, 16.0, -80.0, 20.0), ("wrist", "z", 120, 4.0, 60.0, -50.0))
    lengths, masses = (0.03, 0.03, 0.28, 0.24, 0.12), (1.0, 1.0, 2.0, 1.3, 0.6)
    for arm, way in (("l", 1.0), ("r", -1.0)):
        inside = ""
        for k in reversed(range(len(rows))):
            joint, axis, reach, limit, _, _ = rows[k]
            at = (0, 0, -lengths[k - 1]) if k else (0, 0.2 * way, 1.3)
            end = (0.03, 0.04, -lengths[k]) if k == len(rows) - 1 else (0, 0, -lengths[k])
            inside = _link(f"{joint}_{arm}", at, _hinge(f"{joint}_{arm}", axis, reach, 1e-3 * limit), end, masses[k], inside)
        bodies += inside
        for joint, axis, _, limit, first, last in rows:
            start, goal = (first, last) if arm == "l" else (last, first)
            sign = -1.0 if axis in "xz" and arm == "r" else 1.0
            motors[f"{joint}_{arm}"] = (sign * start, sign * goal, limit)
    return _robot("two-arms", bodies, motors, ("wrist_l", 0.5))


def chain(n: int, *, spatial: bool) -> Robot:
    """Return an open chain of n equal links, 1.2 m and 6 kg in all, stretched along x; joints turn about y, or y and z.

    Each motor holds the stretched chain beyond it with half of its limit; the chain changes from one zigzag to the opposite.
    """
    inside, motors = "", {}
    for k in reversed(range(n)):
        weight = 6.0 * (n - k) / n * _GRAVITY * 1.2 * (n - k) / n / 2
        limit = float(f"{2 * weight:.3g}")
        at, axis = (1.2 / n if k else 0.0, 0, 0), "z" if spatial and k % 2 else "y"
        joint = _hinge(f"j{k + 1}", axis, 60, round(1e-3 * limit, 6))
        inside = _link(f"link{k + 1}", at, joint, (1.2 / n, 0, 0), round(6.0 / n, 6), inside)
        turn = 30.0 if k // (1 + spatial) % 2 else -30.0
        motors[f"j{k + 1}"] = (-turn, turn, limit)
    motors = dict(reversed(motors.items()))
    return _robot(f"{'spatial' if spatial else 'planar'}-{n}", inside, motors, (f"link{n}", 0.3))


# Of the peer [s], to three or four figures.
LEAST_TIMES_S = {
    "five-bar-reach": 0.1624, "knee-leg": 0.1908, "rod-ankle": 0.124, "arm-three": 0.399, "delta-reach": 0.1258,
    "leg-six": 0.1795, "two-arms": 0.2465, "planar-2": 0.3937, "planar-4": 0.3837, "planar-8": 0.3492,
    "planar-12": 0.316, "planar-16": 0.2982, "spatial-4": 0.3725, "spatial-8": 0.3257, "spatial-12": 0.3043,
    "spatial-16": 0.294,
}  # fmt: skip


def robots() -> tuple[Robot, ...]:
    """Return all robots, by motors."""
    chains = [chain(n, spatial=False) for n in (2, 4, 8, 12, 16)] + [chain(n, spatial=True) for n in (4, 8, 12, 16)]
    built = [five_bar(), knee_leg(), rod_ankle(), arm_three(), delta(), leg_six(), two_arms(), *chains]
    return tuple(sorted(built, key=lambda robot: robot.n_motors))


def write_robots(folder: Path, kinds: Sequence[str] = KINDS) -> list[Path]:
    """Write every robot's model and problems into a folder and return the problems' paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for robot in robots():
        (folder / f"{robot.name}.xml").write_text(robot.text, encoding="utf-8")
        for kind in kinds:
            written.append(folder / f"{robot.name}-{kind}.toml")
            written[-1].write_text(robot.problem(kind), encoding="utf-8")
    return written


if __name__ == "__main__":
    print("\n".join(map(str, write_robots(Path(sys.argv[1])))))
