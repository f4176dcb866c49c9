"""What `linkplan compare` prints: the trackers side by side."""

from linkplan.studies.compare.compare import Comparison, comparison_notes, gap_units, rollout_record
from linkplan.studies.output.tables import table


def comparison_text(comparison: Comparison) -> str:
    """Return the trackers side by side."""
    plan = comparison.plan
    lines = []
    units = list(dict.fromkeys(joint.unit for joint in plan.problem.mechanism.independent_joints))
    cases = [(comparison.title, comparison.nominal)]
    if comparison.mismatch is not None:
        cases.append((comparison.mismatch.name, comparison.mismatched))
    for title, runs in cases:
        conditions = next(iter(runs.values())).conditions
        lines += [
            "",
            f"{plan.problem.name}, {title}: MuJoCo {conditions['mujoco']}, {conditions['integrator']},"
            f" step {conditions['timestep_s']:g} s, control period {conditions['control_period_s']:g} s",
        ]
        rows, (lengths, angles) = [], gap_units(plan)
        for name, rollout in runs.items():
            record = rollout_record(plan, rollout)
            rows.append(
                [
                    name,
                    *(record[f"{which}_error_{unit}"] for unit in units for which in ("rms", "max", "final")),
                    *record["peak_effort"].values(),
                    100 * record["saturated_fraction"],
                    *([1e6 * record["loop_gap_max_m"]] if lengths else []),
                    *([1e6 * record["loop_gap_max_rad"]] if angles else []),
                    record["stable"],
                ]
            )
        actuators = plan.problem.mechanism.actuators
        head = [
            "tracker",
            *(f"{which} [{unit}]" for unit in units for which in ("rms", "max", "final")),
            *(f"peak [{a.unit}]" if len(actuators) == 1 else f"peak {a.name} [{a.unit}]" for a in actuators),
            "saturated [%]",
            *(["closure gap [um]"] if lengths else []),
            *(["closure gap [urad]"] if angles else []),
            "stable",
        ]
        lines.append(table(head, rows))
    lines += ["", *(f"note: {note}" for note in notes)] if (notes := comparison_notes(comparison)) else []
    return "\n".join(lines[1:])
