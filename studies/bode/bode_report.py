"""What `linkplan bode` says: a record for files, a table for people."""

from linkplan.studies.bode.bode import BodeStudy
from linkplan.studies.bode.touching import contact_sentence
from linkplan.studies.check.softness import gap_sentence, held_gap
from linkplan.studies.frequency.excitation import EXCITATIONS
from linkplan.studies.frequency.feedback_loops import broken_at
from linkplan.studies.output.digits import radius_figure
from linkplan.studies.output.tables import table


def bode_record(study: BodeStudy) -> dict:
    """Return what `linkplan bode --json` says."""
    mechanism, settings = study.mechanism, study.settings
    hinges = [joint.kind == "hinge" for joint in mechanism.joints]
    by_pose: dict[bytes, dict] = {}
    for entry in study.points:
        point = entry.point
        loop = {
            "broken_at": broken_at(mechanism, entry.channel),
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
        "disputed": list(study.disputed),
        "softness": softness_of(study),
        "contacts": contacts_of(study),
        "points": list(by_pose.values()),
        "worst": {},
        "measurement": None,
    }
    for scan in study.scans:
        joint, line = mechanism.independent_joints[scan.channel], scan.line
        key = f"position_{joint.unit}" if line.name == joint.name else "time_s"
        record["worst"][joint.name] = {
            key: line.shown(scan.positions[scan.worst]),
            **scan.margins[scan.worst].record(),
            "least": {
                name: {"value": found[0], key: line.shown(scan.positions[found[1]])}
                for name in ("gain_margin_db", "phase_margin_deg", "disk_margin", "bandwidth_hz")
                if (found := scan.least(name)) is not None
            },
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
                else joint.said(entry.point.state[0], 5),
                float(entry.point.inertia[entry.channel, entry.channel]),
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
    broken = ""
    if mechanism.dof > 1:
        names = ", ".join(joint.name for joint in mechanism.independent_joints)
        broken = (
            f"each loop is broken at the effort on its coordinate ({names}), made by"
            f" {', '.join(actuator.name for actuator in mechanism.actuators)} together; the others' loops are closed"
        )
    head = ["loop" if mechanism.dof > 1 else f"{joint.name} [{joint.unit}]"]
    units = list(dict.fromkeys("kg m2" if one.kind == "hinge" else "kg" for one in mechanism.independent_joints))
    head += [
        f"inertia [{' or '.join(units)}]",
        "stable",
        "in MuJoCo",
        "|pole|",
        "GM [dB]",
        "PM [deg]",
    ]
    head += ["DM [ms]", "disk", "crossover [Hz]", "bandwidth [Hz]", "resonance [dB]", "max |S|"]
    lines = [f"{study.message[0].upper()}{study.message[1:]}", *([broken] if broken else []), "", table(head, rows)]
    lines += [f"  {said}" for said in crossovers_of(study)]
    for scan in study.scans:
        line, worst = scan.line, scan.margins[scan.worst]
        ends = f"{line.said(scan.positions[0], 4)} to {line.said(scan.positions[-1], 4)} {line.unit}"
        of = "" if mechanism.dof == 1 else f" of the loop of {mechanism.independent_joints[scan.channel].name}"
        said = (
            f"disk margin {worst.disk_margin:.3g}"
            if worst.stable
            else f"unstable, largest pole {radius_figure(worst.spectral_radius)}"
        )
        text = f"over {line.name} from {ends} the worst{of} is {line.place(scan.positions[scan.worst])}: {said}"
        for name, words, unit in (("gain_margin_db", "gain margin", "dB"), ("phase_margin_deg", "phase margin", "deg")):
            least = scan.least(name) if all(m.stable for m in scan.margins) else None
            if least is not None:
                text += f"; least {words} {least[0]:.3g} {unit} at {line.place(scan.positions[least[1]])}"
        lines += ["", text]
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
        lines += ["", not_measured(study)]
    notes = [f"note: {note}" for note in (contacts_of(study), softness_of(study)) if note]
    return "\n".join([*lines, *([""] if notes else []), *notes])


def not_measured(study: BodeStudy) -> str:
    """Return why nothing was measured."""
    if any(point.margins.stable for point in study.points):
        return "not measured: contacts push at the poses where the feedback loop is stable"
    return "not measured: an unstable feedback loop holds no operating point"


def crossovers_of(study: BodeStudy) -> list[str]:
    """Return a sentence for each feedback loop whose open-loop gain is one at several frequencies."""
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
    """Return the sentence on contacts at the poses that are held, None where there are none."""
    return contact_sentence(study.contacts, len(study.points) // study.mechanism.dof)


def softness_of(study: BodeStudy) -> str | None:
    """Return the sentence on the closure gap at the poses that are held, None where it is small."""
    gaps = [held_gap(study.mechanism, entry.point.pose, entry.point.hold) for entry in study.points if entry.channel == 0]
    return gap_sentence(study.mechanism, max(gaps), error=" while the poses are held")
