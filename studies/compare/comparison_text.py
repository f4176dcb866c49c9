"""The text output of `linkplan compare`."""

from collections.abc import Mapping

from linkplan.controllers.rollout import Rollout
from linkplan.planner.plan import Plan
from linkplan.studies.compare.compare import Comparison, comparison_notes, gap_units, rollout_record
from linkplan.studies.output.tables import table


def comparison_text(comparison: Comparison) -> str:
    """Return a table of the trackers for each case, and notes."""
    plan = comparison.plan
    cases = [(comparison.title, comparison.nominal)]
    if comparison.mismatch is not None:
        cases.append((comparison.mismatch.name, comparison.mismatched))
    parts = []
    for title, runs in cases:
        conditions = next(iter(runs.values())).conditions
        parts.append(
            f"{plan.problem.name}, {title}: MuJoCo {conditions['mujoco']}, {conditions['integrator']},"
            f" step {conditions['timestep_s']:g} s, control period {conditions['control_period_s']:g} s\n"
            + _table_of(plan, runs)
        )
    if notes := comparison_notes(comparison):
        parts.append("\n".join(f"note: {note}" for note in notes))
    return "\n\n".join(parts)


def _table_of(plan: Plan, runs: Mapping[str, Rollout]) -> str:
    mechanism = plan.problem.mechanism
    errors = [
        (which, unit)
        for unit in dict.fromkeys(joint.unit for joint in mechanism.independent_joints)
        for which in ("rms", "max", "final")
    ]
    lengths, angles = gap_units(plan)
    gaps = [*(["m"] if lengths else []), *(["rad"] if angles else [])]
    rows = []
    for name, rollout in runs.items():
        record = rollout_record(plan, rollout)
        rows.append(
            [
                name,
                *(record[f"{which}_error_{unit}"] for which, unit in errors),
                *record["peak_effort"].values(),
                100 * record["saturated_fraction"],
                *(1e6 * record[f"loop_gap_max_{unit}"] for unit in gaps),
                record["stable"],
            ]
        )
    actuators = mechanism.actuators
    head = [
        "tracker",
        *(f"{which} [{unit}]" for which, unit in errors),
        *(f"peak [{a.unit}]" if len(actuators) == 1 else f"peak {a.name} [{a.unit}]" for a in actuators),
        "saturated [%]",
        *(f"closure gap [u{unit}]" for unit in gaps),
        "stable",
    ]
    return table(head, rows)
