"""The sentences on a comparison of trackers."""

import numpy as np

from linkplan.controllers.integrator import shares_in_a_step
from linkplan.controllers.rollout import Rollout
from linkplan.models.errors import listed
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.contacts import exclusion
from linkplan.planner.certificate.further_checks import geom_names
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.default_gains import tracking_of
from linkplan.studies.check.holding import why_no_loop
from linkplan.studies.check.softness import gap_sentence, softness_error
from linkplan.studies.compare.compare import Comparison, actuated_by_unit, error_figures

# With less travel [deg or m] a motion is at rest, so errors cannot be compared with its travel.
_STANDS_STILL = 1e-9


def gap_note(plan: Plan, rollout: Rollout) -> str | None:
    """Return the sentence on a run's closure gap and its effect on the joints, or None if the gap is small."""
    mechanism = plan.problem.mechanism
    if not (rollout.finite and gap_sentence(mechanism, *rollout.largest_gaps)):
        return None
    return gap_sentence(mechanism, *rollout.largest_gaps, softness_error(mechanism, rollout.pose_rad))


def contact_note(plan: Plan, rollout: Rollout) -> str | None:
    """Return the sentence on contacts in a run that its plan omits, or None if there were none."""
    met = plan.certificate.contacts if plan.certificate is not None else ()
    if not (rollout.contacts and met):
        return None
    pairs = listed([geom_names(meeting).removeprefix("geoms ") for meeting in met], 3)
    exclusions = " ".join(dict.fromkeys(exclusion(meeting.bodies) for meeting in met[:3]))
    return (
        f"{pairs} touch in MuJoCo, at up to {rollout.contacts} points at once. Plans have no contact forces, and these"
        f" forces open the kinematic loops. {exclusions} in the model's <contact> lets links pass side by side"
    )


def _gap_share(plan: Plan, rollout: Rollout) -> float:
    """Return a run's largest gap: a length divided by the mechanism's extent, or an angle [rad]."""
    gap_m, gap_rad = rollout.largest_gaps
    return max(gap_m / plan.problem.mechanism.extent_m, gap_rad)


def comparison_notes(comparison: Comparison) -> list[str]:
    """Return the sentences on omitted trackers, on runs that ended early, on default gains, and on the nominal runs."""
    runs = sorted(comparison.nominal.items(), key=lambda item: -_gap_share(comparison.plan, item[1]))
    pushed = [note for _, run in runs if (note := contact_note(comparison.plan, run)) is not None]
    found = [(name, note) for name, run in runs if (note := gap_note(comparison.plan, run)) is not None]
    slow = servo_note(comparison.plan.problem.mechanism)
    soft = [f"{name}, {note}" for name, note in found[:1]]
    told = [
        *comparison.left_out,
        *ended_early(comparison),
        *default_gains(comparison),
        *lost_notes(comparison),
        *left_notes(comparison),
    ]
    return [*told, *pushed[:1], *([] if slow is None else [slow]), *soft]


def ended_early(comparison: Comparison) -> list[str]:
    """Return a sentence on each run that ended before the motion did, with the reason."""
    return [
        f"{name}, {case}, ended at t = {run.time_s[-1]:.4g} s: {run.failure}"
        for case, runs in comparison.cases
        for name, run in runs.items()
        if run.failure is not None
    ]


def default_gains(comparison: Comparison) -> list[str]:
    """Return the sentence on PD gains that are default ones, if a tracker runs with them."""
    problem = comparison.plan.problem
    run = [name for name in ("pd", "pd+ff") if name in comparison.nominal]
    if not run or None not in (problem.tracking.kp, problem.tracking.kd):
        return []
    gains = tracking_of(problem).gains_text(problem.mechanism.independent_joints)
    ran = f"gains from the inertia at the start: {' and '.join(run)} used {gains}"
    time = comparison.plan.trajectory.dense_times(1)
    positions = comparison.plan.trajectory.position_at(time)
    why = why_no_loop(problem.mechanism, positions, problem.limits.actuators_effort)
    if why is not None:
        return [f"{ran}; set gains in [tracking], because no tuning can find them: {why}"]
    return [f"{ran}; `linkplan tune` finds gains for a bandwidth and margins"]


def lost_notes(comparison: Comparison) -> list[str]:
    """Return a sentence for each unit in which stable nominal runs have errors larger than the motion's whole travel."""
    mechanism, notes = comparison.plan.problem.mechanism, []
    errors = {name: error_figures(mechanism, run.error_rad) for name, run in comparison.nominal.items() if run.stable}
    reference = next(iter(comparison.nominal.values())).reference_rad
    travels = error_figures(mechanism, reference - reference[0])
    for unit in actuated_by_unit(mechanism):
        largest, travel = f"max_error_{unit}", travels[f"max_error_{unit}"]
        lost = {name: found[largest] for name, found in errors.items() if found[largest] > travel > _STANDS_STILL}
        if lost:
            said = ", ".join(f"{name} by {error:.3g} {unit}" for name, error in lost.items())
            notes.append(
                f"the motion, which travels {travel:.3g} {unit}, is not followed: the largest errors are {said}; 'stable'"
                " only means that a run stays finite and does not oscillate between the effort limits"
            )
    return notes


def left_notes(comparison: Comparison) -> list[str]:
    """Return the sentence on trackers that do not return to a pose at rest."""
    left = {name: None for _, runs in comparison.cases for name, run in runs.items() if not run.returns}
    if not left:
        return []
    return [f"unstable: a machine that starts beside the held pose moves away from it, under {', '.join(left)}"]


def servo_note(mechanism: Mechanism) -> str | None:
    """Return the sentence on servos whose damping more than halves an effort's acceleration in a step, or None."""
    shares = shares_in_a_step(mechanism)
    column = int(np.argmin(shares))
    if shares[column] > 0.5:
        return None
    return (
        "servos slow feedback down in simulation: the model's integrator counts their damping in a step's inertia, which"
        f" leaves {100 * shares[column]:.2g} % of a feedback's acceleration at {mechanism.independent_joints[column].name};"
        ' the planned efforts are unaffected; with integrator="Euler" in the model\'s <option> feedback acts in full'
    )
