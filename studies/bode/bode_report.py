"""What `linkplan bode` says: a record for files, a table for people."""

from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.frequency.excitation import EXCITATIONS
from linkplan.studies.output.tables import table


def bode_record(study: BodeStudy) -> dict:
    """Return what `linkplan bode --json` says."""
    mechanism, settings = study.mechanism, study.settings
    hinges = [joint.kind == "hinge" for joint in mechanism.joints]
    by_pose: dict[bytes, dict] = {}
    for entry in study.points:
        point = entry.point
        loop = {
            **entry.margins.record(),
            "settles_in_mujoco": entry.settles_in_mujoco,
            "continuous": entry.continuous_margins.record(),
        }
        if entry.measured:
            loop["measured"] = {}
            for name, response in entry.measured.items():
                db, deg = response.against(entry.predicted[name])
                loop["measured"][name] = response.record() | {"less_predicted_db": db, "less_predicted_deg": deg}
        row = by_pose.setdefault(
            point.pose.tobytes(),
            {
                "q_deg": {
                    j.name: j.shown(x) for j, x, turns in zip(mechanism.joints, point.pose, hinges, strict=True) if turns
                },
                "q_m": {
                    j.name: float(x) for j, x, turns in zip(mechanism.joints, point.pose, hinges, strict=True) if not turns
                },
                "reduced_inertia_kgm2": float(point.inertia[0, 0]) if mechanism.dof == 1 else point.inertia,
                "holding_effort": {a.name: float(u) for a, u in zip(mechanism.actuators, point.hold, strict=True)},
                "loops": {},
            },
        )
        row["loops"][study.law if mechanism.dof == 1 else _channel_name(study, entry.channel)] = loop
    slides = mechanism.independent_joints[0].kind == "slide"
    weights = ("lqr_position_m", "lqr_velocity_m_s") if slides else ("lqr_position", "lqr_velocity")
    names = weights if study.law == "lqr" else ("kp", "kd")
    names += ("period_s", "delay_periods")
    record = {
        "mechanism": mechanism.name,
        "stable": study.stable,
        "message": study.message,
        "tracker": study.law,
        "gains": {name: getattr(settings, name) for name in names},
        "points": list(by_pose.values()),
        "worst": {},
        "measurement": None,
    }
    for scan in study.scans:
        joint = mechanism.independent_joints[scan.channel]
        record["worst"][joint.name] = {
            f"position_{joint.unit}": joint.shown(scan.positions[scan.worst]),
            **scan.margins[scan.worst].record(),
        }
    if study.method is not None and study.simulated_steps:
        deviation = study.worst_deviation
        record["measurement"] = {
            "method": study.method,
            "excitations": list(EXCITATIONS),
            "simulated_steps": study.simulated_steps,
            "closed_loop_deviation_db": None if deviation is None else deviation[0],
            "closed_loop_deviation_deg": None if deviation is None else deviation[1],
            **study.conditions,
        }
    return record


def _channel_name(study: BodeStudy, channel: int) -> str:
    return f"{study.law} {study.mechanism.independent_joints[channel].name}"


def bode_text(study: BodeStudy) -> str:
    """Return the margins at every pose, the worst case over the reach, and how well the measurement agrees."""
    mechanism = study.mechanism
    joint = mechanism.independent_joints[0]
    rows = []
    for entry in study.points:
        bounds = entry.margins
        rows.append(
            [
                f"{mechanism.independent_joints[entry.channel].name} at {entry.point.name}"
                if mechanism.dof > 1
                else f"{joint.shown(entry.point.state[0]):.5g}",
                float(entry.point.inertia[entry.channel, entry.channel]),
                bounds.stable,
                entry.settles_in_mujoco,
                bounds.spectral_radius,
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
    head = ["loop" if mechanism.dof > 1 else f"{joint.name} [{joint.unit}]"]
    head += [
        f"inertia [{'kg m2' if joint.kind == 'hinge' else 'kg'}]",
        "stable",
        "in MuJoCo",
        "|pole|",
        "GM [dB]",
        "PM [deg]",
    ]
    head += ["DM [ms]", "disk", "crossover [Hz]", "bandwidth [Hz]", "resonance [dB]", "max |S|"]
    lines = [f"{study.message[0].upper()}{study.message[1:]}", "", table(head, rows)]
    for scan in study.scans:
        joint, worst = mechanism.independent_joints[scan.channel], scan.margins[scan.worst]
        ends = f"{joint.shown(scan.positions[0]):.4g} to {joint.shown(scan.positions[-1]):.4g} {joint.unit}"
        said = (
            f"disk margin {worst.disk_margin:.3g}" if worst.stable else f"unstable, largest pole {worst.spectral_radius:.4g}"
        )
        place = f"{joint.name} = {joint.shown(scan.positions[scan.worst]):.4g} {joint.unit}"
        lines += ["", f"over {joint.name} from {ends} the worst is {place}: {said}"]
    deviation = study.worst_deviation
    if deviation is not None:
        c = study.conditions
        lines += [
            "",
            f"measured closed-loop responses ({study.method}, {study.simulated_steps} steps) differ from the prediction"
            " by at most"
            f" {deviation[0]:.2g} dB and {deviation[1]:.2g} deg",
            f"MuJoCo {c['mujoco']}, {c['integrator']}, step {c['timestep_s']:g} s, closure constraints' solref"
            f" {', '.join(f'{x[0]:g} {x[1]:g}' for x in c['solref']) or 'none'}",
        ]
    elif study.method is not None:
        lines += ["", "not measured: an unstable feedback loop holds no operating point"]
    return "\n".join(lines)
