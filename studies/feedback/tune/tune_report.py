"""The result of `linkplan tune`, whose fields are the record `tune.json`: gains, and their margins at every pose."""

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct, field

from linkplan.controllers.trackers.names import BUILT_IN
from linkplan.models.mechanism import Mechanism
from linkplan.models.tree.joints import Joint
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.files.tables import inline
from linkplan.studies.feedback.bode.scan import figures
from linkplan.studies.feedback.frequency.margins import Margins
from linkplan.studies.feedback.tune.requirements import EvaluatedGains, JudgedLoop, Requirements
from linkplan.studies.feedback.tune.tuning import MotorGains, gains_by_joint, tracking_values, tuned_joints
from linkplan.studies.output.document import (
    Axis,
    Block,
    Code,
    DrawnLimit,
    Facts,
    NumberText,
    Plot,
    Report,
    Section,
    Series,
    Table,
    Text,
    table_of,
)
from linkplan.studies.output.figure_spec import FigureSpec, side_by_side
from linkplan.studies.output.numbers import rounded
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import MechanismResult


class Tuning(MechanismResult, Struct, frozen=True, kw_only=True, eq=False):
    """The best gains, whether they meet the requirements at all points (`found`), and the verdict as a sentence.

    `gains` contains period and delay, the gains under the keys of a [tracking] table, and the gains of each motor that
    drives a single joint. `points` are the loops, joint by joint and pose by pose.
    """

    record_name = "tune"

    mechanism_name: str = field(name="mechanism")
    tracker: str
    found: bool
    message: str
    wanted: Requirements
    gains: dict[str, Any]
    note: str | None  # on the choice of the points
    points: tuple[JudgedLoop, ...]
    mechanism: Beside[Mechanism] = field(default=NOT_READ, name="(mechanism)")
    best: Beside[EvaluatedGains] = NOT_READ
    between: Beside[list[tuple[float, Margins]]] = NOT_READ
    """Margins between the poses of one degree of freedom, with their positions [rad or m]."""

    @property
    def passed(self) -> bool:
        """Whether the gains were found; otherwise they are the nearest ones."""
        return self.found

    @property
    def tracking(self) -> dict[str, float | dict[str, float]]:
        """The gains as the `tracking` table of problems, `track`, `compare` and `bode`."""
        return tracking_values(self.best, self.mechanism)

    @property
    def motors(self) -> tuple[MotorGains, ...]:
        """The gains of each motor that drives a single joint; none for weights of LQR."""
        return self.gains.get("motor_side", ())

    @property
    def joints(self) -> list[Joint]:
        """The joints with a feedback loop."""
        return tuned_joints(self.mechanism)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield tune, bandwidth and margins of every joint over the poses."""
        joints, columns = self.joints, []
        for channel, joint in zip(self.mechanism.channels, joints, strict=True):
            loops = [loop for loop in self.points if loop.channel == channel]
            columns.append(tune_plots(self, loops, "" if len(joints) == 1 else f", loop of {joint.name}"))
        size, title = (7.5 if len(joints) == 1 else 4.5, 2.5), f"{self.mechanism.name}: {self.message.split(': ')[0]}"
        yield "tune", FigureSpec(panels=side_by_side(*columns), title=title, columns=len(columns), panel_in=size)

    def blocks(self) -> list[Block]:
        """Return the verdict, the gains of joints and motors, and the margins of every loop at every pose."""
        joints = self.joints
        blocks: list[Block] = [Text(text=self.message)]
        if BUILT_IN[self.tracker].by_errors:
            (position_key, position), (velocity_key, velocity) = list(self.tracking.items())[:2]
            weights = f"{position_key} = {position:.5g}, {velocity_key} = {velocity:.5g}"
            blocks.append(Text(text=f"{weights} (errors weighted like the full effort limit)"))
        else:
            blocks.append(Facts(rows=gain_lines(self)))
        if self.found:
            blocks.append(_worst(self))
        if shared := self.points[0].point.shared_coordinates:
            blocks.append(Facts(rows=[("at every pose", shared)]))
        for channel, joint in zip(self.mechanism.channels, joints, strict=True):
            loops = [loop for loop in self.points if loop.channel == channel]
            blocks += [
                _table(loops, joint, len(joints) > 1),
                *tune_plots(self, loops, "" if len(joints) == 1 else f", loop of {joint.name}"),
            ]
        if len(joints) > 1:
            blocks.append(Text(text="settling time and damping ratio are those of the poles that all loops share"))
        return blocks if self.note is None else [*blocks, Text(text=self.note, tone="note")]

    def document(self) -> Report:
        """Return the report."""
        mechanism, wanted, law = self.mechanism, self.wanted, self.best.law
        rows = [
            ("mechanism", mechanism.name),
            ("tracker", law.name),
            ("wanted bandwidth", f"{wanted.bandwidth_hz:g} Hz at least"),
            ("wanted phase margin", f"{wanted.phase_margin_deg:g} deg at least"),
            ("control period", f"{law.timing.period_s:g} s, delay {law.timing.delay_s:g} s"),
        ]
        if wanted.sensitivity_peak is not None:
            rows.append(("wanted peak of |S|", f"{wanted.sensitivity_peak:g} at most"))
        blocks: list[Block] = [
            Facts(rows=rows),
            Code(title="Gains as the [tracking] table of a problem file", text=tracking_table(self)),
            *self.blocks()[1:],  # the page's header has the verdict
        ]
        section = Section(title=f"Gains for {mechanism.name}", blocks=blocks)
        return report_of(f"Gains for {mechanism.name}", self.message, self.found, [section])

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write tracking.toml, the gains as the table of a problem file."""
        del parquet
        (place / "tracking.toml").write_text(tracking_table(self), encoding="utf-8")


def gain_lines(tuning: Tuning) -> list[tuple[str, str]]:
    """Return PD gains as pairs of a heading and a text, with units: at each joint, and at each motor of one joint."""
    lines = []
    gains = gains_by_joint(tuning.best, tuning.mechanism)
    for joint in tuning.joints:
        (kp, kd), per = gains[joint.name], joint.gain_units
        where = f"the joint {joint.name}" if len(tuning.mechanism.channels) == 1 else joint.name
        lines.append((f"at {where}", f"kp = {kp:.5g} {per[0]}, kd = {kd:.5g} {per[1]}"))
    for motor in tuning.motors:
        over = "" if motor.is_constant else ", over the poses below"
        lines.append((f"at the motor {motor.actuator}, {motor.ratio_text()}", f"{motor.gains_text()}{over}"))
    alone = {motor.actuator for motor in tuning.motors}
    if shared := [actuator.name for actuator in tuning.mechanism.actuators if actuator.name not in alone]:
        text = "no gains of its own, because it is not the only motor of one joint; linkplan transfer gives gain matrices"
        lines.append((f"at the motor {' and '.join(shared)}", text))
    return lines


def places(tuning: Tuning, loops: Sequence[JudgedLoop]) -> tuple[np.ndarray, str, str]:
    """Return the places (n,) of one joint's loops on an axis, its name and unit: the position, or the pose's number."""
    joints = tuning.joints
    if len(joints) > 1:
        return np.arange(1.0, len(loops) + 1), "pose", ""
    at = [joints[0].shown(loop.point.state[loop.channel]) for loop in loops]
    return np.array(at), joints[0].name, joints[0].unit


def tune_plots(tuning: Tuning, loops: Sequence[JudgedLoop], of: str) -> list[Plot]:
    """Return the plots of one joint's margins over the position or the pose, with the requirements; titles end with `of`."""
    (at, place, unit), wanted = places(tuning, loops), tuning.wanted
    order, found = np.argsort(at), []
    margins = [loops[k] for k in order.tolist()]
    curve = sorted(
        [*zip(at[order].tolist(), margins, strict=True)] + [(tuning.joints[0].shown(x), one) for x, one in tuning.between],
        key=lambda one: one[0],
    )
    drawn = rounded(np.array([x for x, _ in curve]))
    lost = at[order][[not one.stable for one in margins]]
    for name, what, per, limit, words in (
        ("bandwidth_hz", "bandwidth", "Hz", wanted.bandwidth_hz, "wanted at least"),
        ("phase_margin_deg", "phase margin", "deg", wanted.phase_margin_deg, "wanted at least"),
        ("sensitivity_peak", "peak of |S|", "1", wanted.largest_peak, "wanted at most"),
    ):
        values, asked = figures(margins, name), [limit] if np.isfinite(limit) and limit > 0 else []
        known = [value for value in (*figures([one for _, one in curve], name).tolist(), *asked) if value > 0]
        highest, lowest = max(known, default=1.0), min(known, default=1.0)
        log = per == "Hz" and highest > 10 * lowest
        ends = (lowest / 4.0, 1.5 * highest) if log else (0.0, 1.12 * highest)  # room for the limit's name below its line
        values, line = (np.maximum(y, ends[0]) for y in (values, figures([one for _, one in curve], name)))
        series = [Series(name=what, x=drawn, y=rounded(line)), Series(name="looked at", y=rounded(values), look="points")]
        if len(lost):
            series.append(Series(name="unstable", x=rounded(lost), y=[ends[0]] * len(lost), look="points", colour=4))
        found.append(
            Plot(
                title=f"{what[:1].upper()}{what[1:]} over the {place if of else 'position'}{of}",
                group="along:tune",
                x_axis=Axis(label=place, unit=unit or "1"),
                y_axis=Axis(label=what, unit=per, log=log, ends=ends),
                x=rounded(at[order]),
                series=series,
                limits=[DrawnLimit(name=words, value=float(x)) for x in asked],
            )
        )
    return found


def tracking_table(tuning: Tuning) -> str:
    """Return the gains as the text of the [tracking] table of a problem file."""
    lines = [*textwrap.wrap(f"# {tuning.message}", 110, subsequent_indent="# ", break_on_hyphens=False), "[tracking]"]
    for key, value in tuning.tracking.items():
        rounded = {name: float(f"{gain:.6g}") for name, gain in value.items()} if isinstance(value, dict) else None
        lines.append(f"{key} = {value:.6g}" if rounded is None else f"{key} = {inline(rounded, key)}")
    return "\n".join(lines) + "\n"


def _worst(tuning: Tuning) -> Table:
    """Return the requirements, the worst values over all loops and poses, and their places."""
    best, wanted = tuning.best, tuning.wanted
    farthest, (stiffness, softest) = best.farthest_at_rest(), best.worst("stiffness_at_rest")
    unit = tuning.mechanism.independent_joints[softest.channel].gain_units[0]
    rows: list[list] = []
    for words, asked, (value, at) in (
        ("bandwidth -3 dB [Hz]", wanted.bandwidth_hz, best.worst("bandwidth_hz")),
        ("phase margin [deg]", wanted.phase_margin_deg, best.worst("phase_margin_deg")),
        ("peak of |S|", wanted.sensitivity_peak, best.worst("sensitivity_peak", largest=True)),
        ("time to settle to 2 % [s]", None, best.worst("settling_s", largest=True)),
        ("a small step settles at [%]", None, (100 * farthest.response_at_rest, farthest)),
        (f"stiffness at rest [{unit}]", None, (stiffness, softest)),
    ):
        if value is not None:
            rows.append([words, "" if asked is None else asked, value, at.name])
    return table_of("Worst over all positions", ["quantity", "asked", "worst", "at"], rows)


def _table(loops: Sequence[JudgedLoop], joint: Joint, several: bool) -> Table:
    """Return the margins of one joint's loop at every pose as a table, with the positions that differ."""
    shown, coordinates = loops[0].point.told, loops[0].point.mechanism.independent_joints
    rows = [
        [
            *(NumberText.of(coordinates[k].text(x := loop.point.state[k], 5), coordinates[k].shown(x)) for k in shown),
            loop.stable,
            loop.bandwidth_hz,
            loop.phase_margin_deg,
            loop.gain_margin_db,
            loop.sensitivity_peak,
            loop.settling_s,
            loop.damping_ratio,
            loop.response_at_rest,
            loop.stiffness_at_rest,
        ]
        for loop in loops
    ]
    heads: list = [(coordinates[k].name, coordinates[k].unit) for k in shown]
    heads += ["stable", "bandwidth -3 dB [Hz]", "phase margin [deg]", "gain margin [dB]", "peak of |S|"]
    heads += ["settling [s]", "damping", "response at rest", f"stiffness [{joint.gain_units[0]}]"]
    of = f", the loop of {joint.name}, the others closed" if several else ""
    return table_of(f"At every analysed position{of}", heads, rows)
