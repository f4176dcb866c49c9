"""The output of `linkplan tune`: a JSON record, the [tracking] table of a problem file, and the result as a document."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkplan.models.actuation.actuators import Actuator
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.poses.along import sampled
from linkplan.models.transfer.polytope import motor_gains as gains_at_motors
from linkplan.models.tree.joints import Joint
from linkplan.planner.files.tables import inline
from linkplan.studies.bode.scan import figures
from linkplan.studies.output.document import Axis, Block, Facts, Limit, Plot, Series, Table, Text, table_of
from linkplan.studies.output.numbers import rounded
from linkplan.studies.tune.judged import JudgedLoop
from linkplan.studies.tune.tune import Tuning

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def tuned_joints(tuning: Tuning) -> list[Joint]:
    """Return the joints with a feedback loop."""
    return [tuning.mechanism.independent_joints[channel] for channel in tuning.mechanism.channels]


def joint_gains(tuning: Tuning) -> dict[str, tuple[float, float]]:
    """Return kp and kd of every joint with a loop, by its name."""
    settings, joints = tuning.best.law.settings, tuning.mechanism.independent_joints
    gains = np.array(settings.gains(joints)).T
    return {
        joints[channel].name: (float(gains[channel, 0]), float(gains[channel, 1])) for channel in tuning.mechanism.channels
    }


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MotorGains:
    """Gains of one motor, its effort over its own motion, at the poses (n,) of a tuning.

    `ratio` is the motor's motion per motion of the joint, `kp` and `kd` are infinite or NaN where it is zero: a dead centre.
    """

    actuator: Actuator
    joint: Joint
    ratio: np.ndarray
    kp: np.ndarray
    kd: np.ndarray

    @property
    def is_constant(self) -> bool:
        """True if the transmission has the same ratio at all poses, so that one pair of gains serves them all."""
        return bool(np.ptp(self.ratio) <= ROUNDING_SHARE * np.abs(self.ratio).max())

    def said_gains(self) -> str:
        """Return the gains as text: one pair, or their ranges over the poses."""
        pairs = zip(("kp", "kd"), (self.kp, self.kd), self.actuator.gain_units, strict=True)
        return ", ".join(f"{name} = {self._said(values)} {unit}" for name, values, unit in pairs)

    def said_ratio(self) -> str:
        """Return the transmission's ratio as text: "ratio 20 to crank", "ratio 0.022 to 0.028 m/rad to K"."""
        own, driven = self.actuator.si_units[0], self.joint.si_units[0]
        unit = "" if own == driven else f" {own}/{driven}"
        return f"ratio {self._said(np.abs(self.ratio))}{unit} to {self.joint.name}"

    def _said(self, values: np.ndarray) -> str:
        low, high = (f"{value:.5g}" for value in (values.min(), values.max()))
        return low if self.is_constant else f"{low} to {high}"


def motor_gains(tuning: Tuning) -> list[MotorGains]:
    """Return the motors' gains that give the joints' gains, K_o = G^T K_m G at every pose, for motors of one joint each.

    A motor that moves with several joints is left out: no gains of its own give their loops.
    """
    mechanism, joints = tuning.mechanism, tuned_joints(tuning)
    poses = np.array([loop.point.pose for loop in tuning.best.loops if loop.channel == mechanism.channels[0]])
    ratio = sampled(mechanism.dynamics.effort_map, poses)[:, list(mechanism.channels)].transpose(0, 2, 1)  # (n, n_u, n_o)
    gains = [np.diag(values) for values in zip(*joint_gains(tuning).values(), strict=True)]
    kp, kd = (gains_at_motors(ratio, values) for values in gains)
    acts = np.abs(ratio).max(axis=0) > ROUNDING_SHARE * np.abs(ratio).max(axis=(0, 1))
    found = []
    for m in np.flatnonzero(acts.sum(axis=1) == 1):
        (o,) = np.flatnonzero(acts[m])
        if acts[:, o].sum() > 1:
            continue
        found.append(
            MotorGains(
                actuator=mechanism.actuators[m], joint=joints[o], ratio=ratio[:, m, o], kp=kp[:, m, m], kd=kd[:, m, m]
            )
        )
    return found


def motor_record(motor: MotorGains) -> dict:
    """Return a motor's gains as JSON: null for a single value where the transmission's ratio changes with the pose."""
    record: dict = {"actuator": motor.actuator.name, "joint": motor.joint.name, "gear": motor.actuator.gear}
    for name, values in (("ratio", motor.ratio), ("kp", motor.kp), ("kd", motor.kd)):
        record[name] = float(values[0]) if motor.is_constant else None
        record[f"{name}_range"] = [float(values.min()), float(values.max())] if np.all(np.isfinite(values)) else None
    return record | {"units": list(motor.actuator.gain_units)}


def gain_lines(tuning: Tuning) -> list[tuple[str, str]]:
    """Return PD gains as pairs of a heading and a text, with units: at each joint, and at each motor of one joint."""
    lines = []
    for joint in tuned_joints(tuning):
        (kp, kd), per = joint_gains(tuning)[joint.name], joint.gain_units
        where = f"the joint {joint.name}" if len(tuning.mechanism.channels) == 1 else joint.name
        lines.append((f"at {where}", f"kp = {kp:.5g} {per[0]}, kd = {kd:.5g} {per[1]}"))
    found = motor_gains(tuning)
    for motor in found:
        over = "" if motor.is_constant else ", over the poses below"
        lines.append((f"at the motor {motor.actuator.name}, {motor.said_ratio()}", f"{motor.said_gains()}{over}"))
    alone = [motor.actuator for motor in found]
    if shared := [actuator.name for actuator in tuning.mechanism.actuators if actuator not in alone]:
        text = "no gains of its own, because it moves several joints; linkplan transfer has the gains as matrices"
        lines.append((f"at the motor {' and '.join(shared)}", text))
    return lines


def places(tuning: Tuning, loops: Sequence[JudgedLoop]) -> tuple[np.ndarray, str, str]:
    """Return the places (n,) of one joint's loops on an axis, its name and unit: the position, or the pose's number."""
    joints = tuned_joints(tuning)
    if len(joints) > 1:
        return np.arange(1.0, len(loops) + 1), "pose", ""
    at = [joints[0].shown(loop.point.state[loop.channel]) for loop in loops]
    return np.array(at), joints[0].name, joints[0].unit


def tune_plots(tuning: Tuning, loops: Sequence[JudgedLoop], of: str) -> list[Plot]:
    """Return the plots of one joint's margins over the position or the pose, with the requirements; `of` ends the titles."""
    (at, place, unit), wanted = places(tuning, loops), tuning.wanted
    order, found = np.argsort(at), []
    margins = [loops[k].margins for k in order]
    lost = at[order][[not one.stable for one in margins]]
    for name, what, per, limit, words in (
        ("bandwidth_hz", "bandwidth", "Hz", wanted.bandwidth_hz, "wanted at least"),
        ("phase_margin_deg", "phase margin", "deg", wanted.phase_margin_deg, "wanted at least"),
        ("sensitivity_peak", "peak of |S|", "1", wanted.sensitivity_peak, "wanted at most"),
    ):
        values, asked = figures(margins, name), [limit] if np.isfinite(limit) and limit > 0 else []
        series = [Series(name=what, y=rounded(values)), Series(name="looked at", y=rounded(values), look="points")]
        if len(lost):
            series.append(Series(name="unstable", x=rounded(lost), y=[0.0] * len(lost), look="points", colour=4))
        highest = max([*values[np.isfinite(values)].tolist(), *asked], default=0.0)
        found.append(
            Plot(
                title=f"{what[:1].upper()}{what[1:]} over the {place if of else 'position'}{of}",
                group="along:tune",
                x_axis=Axis(label=place, unit=unit or "1"),
                y_axis=Axis(label=what, unit=per, ends=(0.0, 1.12 * highest or 1.0)),
                x=rounded(at[order]),
                series=series,
                limits=[Limit(name=words, value=float(x)) for x in asked],
            )
        )
    return found


def tune_figure(tuning: Tuning, path: Path | None = None) -> "Figure":
    """Return the figure of every joint's margins over the poses, saved at `path` if given."""
    from linkplan.studies.output.figure import figure_of, side_by_side

    joints, columns = tuned_joints(tuning), []
    for channel, joint in zip(tuning.mechanism.channels, joints, strict=True):
        loops = [loop for loop in tuning.best.loops if loop.channel == channel]
        columns.append(tune_plots(tuning, loops, "" if len(joints) == 1 else f", loop of {joint.name}"))
    size, title = (7.5 if len(joints) == 1 else 4.5, 2.5), f"{tuning.mechanism.name}: {tuning.message}"
    return figure_of(side_by_side(*columns), path, title=title, columns=len(columns), panel_in=size)


def tune_record(tuning: Tuning) -> dict:
    """Return the JSON record of `linkplan tune`."""
    timing, wanted = tuning.best.law.timing, tuning.wanted
    gains: dict = {"period_s": timing.period_s, "delay_s": timing.delay_s}
    values, joints = tracking_values(tuning), tuned_joints(tuning)
    gains |= {key: value for key, value in values.items() if key not in ("period_s", "delay_periods")}
    if tuning.best.law.name != "lqr":
        gains |= {"motor_side": [motor_record(motor) for motor in motor_gains(tuning)]}
    return {
        "mechanism": tuning.mechanism.name,
        "tracker": tuning.best.law.name,
        "found": tuning.found,
        "message": tuning.message,
        "wanted": asdict(wanted)
        | {
            "sensitivity_peak": wanted.sensitivity_peak if np.isfinite(wanted.sensitivity_peak) else None,
            "settling_s": wanted.longest_settling_s,
            "response_at_rest": wanted.response_at_rest if wanted.stiffness is None else None,
        },
        "gains": gains,
        "note": tuning.note,
        "points": [_place(loop, joints) | asdict(loop.margins) for loop in tuning.best.loops],
    }


def _place(loop: JudgedLoop, joints: Sequence[Joint]) -> dict:
    """Return where a loop was judged: the position of a single joint, or the joint of the loop and all positions."""
    own = loop.point.mechanism.independent_joints[loop.channel]
    if len(joints) == 1:
        return {f"position_{own.unit}": own.shown(loop.point.state[loop.channel])}
    at = dict(zip(loop.point.mechanism.channels, joints, strict=True))
    hinges = {joint.name: joint.shown(loop.point.state[k]) for k, joint in at.items() if joint.kind == "hinge"}
    slides = {joint.name: float(loop.point.state[k]) for k, joint in at.items() if joint.kind != "hinge"}
    return {"joint": own.name, "position_deg": hinges, "position_m": slides}


def tracking_values(tuning: Tuning) -> dict:
    """Return the gains under the keys of the [tracking] table of a problem file; with several loops by joint."""
    settings, joints = tuning.best.law.settings, tuned_joints(tuning)
    values: dict = {"kp": settings.kp, "kd": settings.kd}
    if tuning.best.law.name == "lqr":
        position, velocity = (joints[0].shown(float(weight[0])) for weight in settings.lqr_errors(joints))
        values = {f"lqr_position_{joints[0].unit}": position, f"lqr_velocity_{joints[0].unit}_s": velocity}
    values |= {"period_s": settings.period_s}
    if settings.delay_periods and float(settings.delay_periods).is_integer():
        values |= {"delay_periods": int(settings.delay_periods)}
    return values


def tracking_table(tuning: Tuning) -> str:
    """Return the gains as the text of the [tracking] table of a problem file."""
    lines = [f"# {tuning.message}", "[tracking]"]
    for key, value in tracking_values(tuning).items():
        rounded = {name: float(f"{gain:.6g}") for name, gain in value.items()} if isinstance(value, dict) else None
        lines.append(f"{key} = {value:.6g}" if rounded is None else f"{key} = {inline(rounded, key)}")
    return "\n".join(lines) + "\n"


def tune_blocks(tuning: Tuning, *, verdict: bool = True) -> list[Block]:
    """Return the gains in the joints' and the motor's units, and the margins of every loop at every pose.

    The verdict is left out where the page's header shows it.
    """
    joints = tuned_joints(tuning)
    blocks: list[Block] = [Text(text=tuning.message)] if verdict else []
    if tuning.best.law.name == "lqr":
        (position_key, position), (velocity_key, velocity) = list(tracking_values(tuning).items())[:2]
        weights = f"{position_key} = {position:.5g}, {velocity_key} = {velocity:.5g}"
        blocks.append(Text(text=f"{weights} (errors weighted like the full effort limit)"))
    else:
        blocks.append(Facts(rows=gain_lines(tuning)))
    if alike := tuning.best.loops[0].point.alike:
        blocks.append(Facts(rows=[("at every pose", alike)]))
    for channel, joint in zip(tuning.mechanism.channels, joints, strict=True):
        loops = [loop for loop in tuning.best.loops if loop.channel == channel]
        blocks += [
            _table(loops, joint, len(joints) > 1),
            *tune_plots(tuning, loops, "" if len(joints) == 1 else f", loop of {joint.name}"),
        ]
    if len(joints) > 1:
        blocks.append(Text(text="settling and damping belong to the poles that all loops share"))
    return blocks if tuning.note is None else [*blocks, Text(text=tuning.note, tone="note")]


def _table(loops: Sequence[JudgedLoop], joint: Joint, several: bool) -> Table:
    """Return the margins of one joint's loop at every pose as a table, with the positions that differ."""
    shown, coordinates = loops[0].point.told, loops[0].point.mechanism.independent_joints
    rows = [
        [
            *(coordinates[k].said(loop.point.state[k], 5) for k in shown),
            loop.margins.stable,
            loop.margins.bandwidth_hz,
            loop.margins.phase_margin_deg,
            loop.margins.gain_margin_db,
            loop.margins.sensitivity_peak,
            loop.margins.settling_s,
            loop.margins.damping_ratio,
            loop.margins.response_at_rest,
            loop.margins.stiffness_at_rest,
        ]
        for loop in loops
    ]
    heads: list = [(coordinates[k].name, coordinates[k].unit) for k in shown]
    heads += ["stable", "bandwidth -3 dB [Hz]", "phase margin [deg]", "gain margin [dB]", "peak of |S|"]
    heads += ["settling [s]", "damping", "response at rest", f"stiffness [{joint.gain_units[0]}]"]
    of = f", the loop of {joint.name}, the others closed" if several else ""
    return table_of(f"At every position looked at{of}", heads, rows)
