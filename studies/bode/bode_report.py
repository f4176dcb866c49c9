"""The output of `linkplan bode`: a JSON record, and figures of responses, Nyquist curves and margins along a line."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from linkplan.studies.bode.bode import BodePoint, BodeStudy
from linkplan.studies.bode.bode_blocks import contacts_of, margins_along, nyquist, responses, sensitivities, softness_of
from linkplan.studies.bode.scan import Scan
from linkplan.studies.frequency.excitation import EXCITATIONS
from linkplan.studies.frequency.feedback_loops import OperatingPoint, broken_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def bode_record(study: BodeStudy) -> dict:
    """Return the JSON record of `linkplan bode`."""
    mechanism, law = study.mechanism, study.law
    by_pose: dict[bytes, dict] = {}
    for entry in study.points:
        name = law.name
        if len(mechanism.channels) > 1:
            name += f" {mechanism.independent_joints[entry.channel].name}"
        row = by_pose.setdefault(entry.point.pose.tobytes(), _pose_record(entry.point))
        row["loops"][name] = _loop_record(entry)
    slides = mechanism.independent_joints[0].kind == "slide"
    weights = ("lqr_position_m", "lqr_velocity_m_s") if slides else ("lqr_position_deg", "lqr_velocity_deg_s")
    names = (*(weights if law.name == "lqr" else ("kp", "kd")), "period_s", "delay_periods")
    return {
        "mechanism": mechanism.name,
        "stable": study.stable,
        "message": study.message,
        "tracker": law.name,
        "gains": {name: getattr(law.settings, name) for name in names},
        "disputed": list(study.disputed),
        "softness": softness_of(study),
        "contacts": contacts_of(study),
        "points": list(by_pose.values()),
        "worst": {mechanism.independent_joints[scan.channel].name: _scan_record(study, scan) for scan in study.scans},
        "measurement": _measurement_record(study),
        "note": study.note,
    }


def _pose_record(point: OperatingPoint) -> dict:
    mechanism = point.mechanism
    joints = list(zip(mechanism.joints, point.pose, strict=True))
    return {
        "q_deg": {joint.name: joint.shown(x) for joint, x in joints if joint.kind == "hinge"},
        "q_m": {joint.name: float(x) for joint, x in joints if joint.kind != "hinge"},
        "reduced_inertia_kgm2": float(point.inertia[0, 0]) if mechanism.dof == 1 else point.inertia,
        "holding_effort": {a.name: float(u) for a, u in zip(mechanism.actuators, point.hold, strict=True)},
        "loops": {},
    }


def _loop_record(entry: BodePoint) -> dict:
    loop = {
        "broken_at": broken_at(entry.point.mechanism, entry.channel),
        **asdict(entry.margins),
        "settles_in_mujoco": entry.settles_in_mujoco,
        "continuous": asdict(entry.continuous_margins),
    }
    if entry.measured:
        loop["measured"] = {}
        for name, response in entry.measured.items():
            db, deg = response.against(entry.predicted[name])
            loop["measured"][name] = response.record() | {"less_predicted_db": db, "less_predicted_deg": deg}
    return loop


def _scan_record(study: BodeStudy, scan: Scan) -> dict:
    joint, line = study.mechanism.independent_joints[scan.channel], scan.line
    key = f"position_{joint.unit}" if line.name == joint.name else "time_s"
    return {
        key: line.shown(scan.positions[scan.worst]),
        **asdict(scan.margins[scan.worst]),
        "least": {
            name: {"value": found[0], key: line.shown(scan.positions[found[1]])}
            for name in ("gain_margin_db", "gain_reduction_margin_db", "phase_margin_deg", "disk_margin", "bandwidth_hz")
            if (found := scan.least(name)) is not None
        },
    }


def _measurement_record(study: BodeStudy) -> dict | None:
    if not study.is_measured or not study.simulated_steps:
        return None
    deviation = study.worst_deviation
    return {
        "method": "sinestream",
        "excitations": list(EXCITATIONS),
        "simulated_steps": study.simulated_steps,
        "closed_loop_deviation_db": None if deviation is None else deviation[0],
        "closed_loop_deviation_deg": None if deviation is None else deviation[1],
        **study.conditions,
    }


def save_bode(study: BodeStudy, place: Path) -> None:
    """Draw every figure of a study into a folder: bode.png, nyquist.png, sensitivity.png and margins.png."""
    from linkplan.studies.output.figure import figure_of

    joints, title = study.mechanism.independent_joints, f"{study.mechanism.name}, {study.law.name}: {study.loop_name}"
    channels = study.mechanism.channels
    suffixes = {channel: f"-{joints[channel].name}" if len(channels) > 1 else "" for channel in channels}
    for channel, suffix in suffixes.items():
        entries = [entry for entry in study.points if entry.channel == channel]
        bode_figure(study, entries, place / f"bode{suffix}.png")
        figure_of([nyquist(study, entries)], place / f"nyquist{suffix}.png", title=title, panel_in=(6.4, 7.0))
        figure_of(sensitivities(entries, ""), place / f"sensitivity{suffix}.png", title=title, columns=3)
    for scan in study.scans:
        panels = margins_along(study, scan, "")
        figure_of(panels, place / f"margins{suffixes[scan.channel]}.png", title=title, panel_in=(8.0, 3.5))


def bode_figure(study: BodeStudy, entries: Sequence[BodePoint], path: Path | None = None) -> "Figure":
    """Return the figure of open and closed loop at every pose, saved at `path` if given."""
    from linkplan.studies.output.figure import figure_of, side_by_side

    how = "line: predicted, sampled; dotted: continuous"
    how += "; dots: MuJoCo, sinestream" if any(entry.measured for entry in entries) else ""
    title = f"{study.mechanism.name}, {study.law.name}: {study.message}; {how}"
    return figure_of(
        side_by_side(*responses(study, entries, "").values()), path, title=title, columns=2, panel_in=(6.0, 2.9)
    )
