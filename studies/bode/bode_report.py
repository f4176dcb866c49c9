"""The output of `linkplan bode`: a JSON record and a text table."""

from linkplan.studies.bode.bode import BodePoint, BodeStudy
from linkplan.studies.bode.scan import Scan, bounds_text
from linkplan.studies.bode.touching import contact_sentence
from linkplan.studies.check.softness import gap_sentence, held_gap
from linkplan.studies.frequency.excitation import EXCITATIONS
from linkplan.studies.frequency.feedback_loops import OperatingPoint, broken_at
from linkplan.studies.output.digits import radius_figure
from linkplan.studies.output.tables import table


def bode_record(study: BodeStudy) -> dict:
    """Return the JSON record of `linkplan bode`."""
    mechanism, settings = study.mechanism, study.settings
    by_pose: dict[bytes, dict] = {}
    for entry in study.points:
        row = by_pose.setdefault(entry.point.pose.tobytes(), _pose_record(entry.point))
        row["loops"][study.law if mechanism.dof == 1 else _channel_name(study, entry.channel)] = _loop_record(entry)
    slides = mechanism.independent_joints[0].kind == "slide"
    weights = ("lqr_position_m", "lqr_velocity_m_s") if slides else ("lqr_position", "lqr_velocity")
    names = (*(weights if study.law == "lqr" else ("kp", "kd")), "period_s", "delay_periods")
    return {
        "mechanism": mechanism.name,
        "stable": study.stable,
        "message": study.message,
        "tracker": study.law,
        "gains": {name: getattr(settings, name) for name in names},
        "disputed": list(study.disputed),
        "softness": softness_of(study),
        "contacts": contacts_of(study),
        "points": list(by_pose.values()),
        "worst": {mechanism.independent_joints[scan.channel].name: _scan_record(study, scan) for scan in study.scans},
        "measurement": _measurement_record(study),
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
        **entry.margins.record(),
        "settles_in_mujoco": entry.settles_in_mujoco,
        "continuous": entry.continuous_margins.record(),
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
        **scan.margins[scan.worst].record(),
        "least": {
            name: {"value": found[0], key: line.shown(scan.positions[found[1]])}
            for name in ("gain_margin_db", "phase_margin_deg", "disk_margin", "bandwidth_hz")
            if (found := scan.least(name)) is not None
        },
    }


def _measurement_record(study: BodeStudy) -> dict | None:
    if study.method is None or not study.simulated_steps:
        return None
    deviation = study.worst_deviation
    return {
        "method": study.method,
        "excitations": list(EXCITATIONS),
        "simulated_steps": study.simulated_steps,
        "closed_loop_deviation_db": None if deviation is None else deviation[0],
        "closed_loop_deviation_deg": None if deviation is None else deviation[1],
        **study.conditions,
    }


def _channel_name(study: BodeStudy, channel: int) -> str:
    return f"{study.law} {study.mechanism.independent_joints[channel].name}"


def bode_text(study: BodeStudy) -> str:
    """Return the margins at every pose, the worst case over the reach, and the agreement with the measurement."""
    lines = [f"{study.message[0].upper()}{study.message[1:]}"]
    if study.mechanism.dof > 1:
        names = ", ".join(joint.name for joint in study.mechanism.independent_joints)
        lines.append(
            f"each loop is broken at the effort on its coordinate ({names}), made by"
            f" {', '.join(actuator.name for actuator in study.mechanism.actuators)} together; the others' loops are closed"
        )
    lines += ["", _margin_table(study), *(f"  {sentence}" for sentence in crossovers_of(study))]
    for scan in study.scans:
        lines += ["", _scan_text(study, scan)]
    if study.method is not None:
        lines += ["", *_measurement_lines(study)]
    notes = [f"note: {note}" for note in (contacts_of(study), softness_of(study)) if note]
    return "\n".join([*lines, *([""] if notes else []), *notes])


def _margin_table(study: BodeStudy) -> str:
    """Return the table of margins, a row for each loop and pose."""
    mechanism = study.mechanism
    joint = mechanism.independent_joints[0]
    units = dict.fromkeys("kg m2" if one.kind == "hinge" else "kg" for one in mechanism.independent_joints)
    head = ["loop" if mechanism.dof > 1 else f"{joint.name} [{joint.unit}]", f"inertia [{' or '.join(units)}]"]
    head += ["stable", "in MuJoCo", "|pole|", "GM [dB]", "PM [deg]", "DM [ms]", "disk"]
    head += ["crossover [Hz]", "bandwidth [Hz]", "resonance [dB]", "max |S|"]
    rows = []
    for entry in study.points:
        bounds, point = entry.margins, entry.point
        loop = f"{mechanism.independent_joints[entry.channel].name} at {point.name}"
        rows.append(
            [
                loop if mechanism.dof > 1 else joint.said(point.state[0], 5),
                float(point.inertia[entry.channel, entry.channel]),
                bounds.stable,
                entry.settles_in_mujoco,
                radius_figure(bounds.spectral_radius),
                bounds.gain_margin_db,
                bounds.phase_margin_deg,
                None if bounds.delay_margin_s is None else 1e3 * bounds.delay_margin_s,
                bounds.disk_margin,
                bounds.crossover_hz,
                bounds.bandwidth_hz,
                bounds.resonance_db,
                bounds.sensitivity_peak,
            ]
        )
    return table(head, rows)


def _scan_text(study: BodeStudy, scan: Scan) -> str:
    """Return the worst margins along a line."""
    line, joints = scan.line, study.mechanism.independent_joints
    ends = f"{line.said(scan.positions[0], 4)} to {line.said(scan.positions[-1], 4)} {line.unit}"
    of_loop = "" if len(joints) == 1 else f" of the loop of {joints[scan.channel].name}"
    worst = f"{line.place(scan.positions[scan.worst])}: {bounds_text(scan.margins[scan.worst])}"
    text = f"over {line.name} from {ends} the worst{of_loop} is {worst}"
    for name, words, unit in (("gain_margin_db", "gain margin", "dB"), ("phase_margin_deg", "phase margin", "deg")):
        least = scan.least(name) if all(m.stable for m in scan.margins) else None
        if least is not None:
            text += f"; least {words} {least[0]:.3g} {unit} at {line.place(scan.positions[least[1]])}"
    return text


def _measurement_lines(study: BodeStudy) -> list[str]:
    """Return the agreement of measurement and prediction, or the reason why nothing was measured."""
    deviation, c = study.worst_deviation, study.conditions
    if deviation is None:
        return [not_measured(study)]
    return [
        f"measured closed-loop responses ({study.method}, {study.simulated_steps} steps) differ from the prediction"
        f" by at most {deviation[0]:.2g} dB and {deviation[1]:.2g} deg",
        f"MuJoCo {c['mujoco']}, {c['integrator']}, step {c['timestep_s']:g} s, closure constraints' solref"
        f" {', '.join(f'{x[0]:g} {x[1]:g}' for x in c['solref']) or 'none'}",
    ]


def not_measured(study: BodeStudy) -> str:
    """Return the reason why nothing was measured."""
    if any(point.margins.stable for point in study.points):
        return "not measured: contacts push at the poses where the feedback loop is stable"
    return "not measured: an unstable feedback loop holds no operating point"


def crossovers_of(study: BodeStudy) -> list[str]:
    """Return a sentence for each feedback loop with several gain crossovers."""
    found = []
    for entry in study.points:
        at, others = entry.margins.crossover_hz, entry.margins.other_crossovers_hz
        if others:
            joint = study.mechanism.independent_joints[entry.channel].name
            loop = f"{joint} at {entry.point.name}" if study.mechanism.dof > 1 else entry.point.name
            frequencies = ", ".join(f"{f:.4g}" for f in others)
            found.append(f"{loop}: the gain is one at {frequencies} Hz too; the phase margin is least at {at:.4g} Hz")
    return found


def contacts_of(study: BodeStudy) -> str | None:
    """Return the sentence on contacts at the poses, or None if there is no contact."""
    return contact_sentence(study.contacts, len(study.points) // study.mechanism.dof)


def softness_of(study: BodeStudy) -> str | None:
    """Return the sentence on the closure gap at the poses, or None if it is small."""
    gaps = [held_gap(study.mechanism, entry.point.pose, entry.point.hold) for entry in study.points if entry.channel == 0]
    return gap_sentence(study.mechanism, max(gaps), error=" while the poses are held")
