"""A certificate as a checklist: every limit with its worst value and the instant of this value."""

from msgspec.structs import replace

from linkplan.planner.certificate.certificate import (
    BOUNDARY_SHARE,
    CLOSURE_M,
    INTEGRATION_M,
    Certificate,
)
from linkplan.planner.certificate.further_checks import geom_names
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.kinds import INTEGRATION_DEG
from linkplan.planner.problem.sites import task_words
from linkplan.planner.trajectory import VELOCITY_SHARE
from linkplan.studies.output.document import Checklist, Item
from linkplan.studies.output.draw_plan import LEAST_SHOWN
from linkplan.studies.output.numbers import significant

# The first words of the certificate's sentence on the velocity. The verdict also uses the integrated velocity, so the
# residual alone does not decide it.
_NOT_ITS_VELOCITY = "the planned velocity is not"


def certificate_list(plan: Plan, group: str = "") -> Checklist:
    """Return the certificate's checklist of a plan with a motion; its instants move the cursor of `group`."""
    certificate = plan.certificate
    assert certificate is not None  # of a motion
    items = [
        *(
            _item(
                (margin.title if margin.of.facts.bound is None else margin.bound).removeprefix("the ").rstrip(","),
                margin.kept,
                margin.value if abs(margin.value) > LEAST_SHOWN else 0.0,  # zero for rounding errors
                margin.limit,
                margin.unit,
                margin.time_s,
            )
            for margin in certificate.margins
        ),
        *_numerics(plan, certificate),
        *_contacts(plan, certificate),
    ]
    return Checklist(title="Checks between the nodes", group=group, items=items)


def _numerics(plan: Plan, certificate: Certificate) -> list[Item]:
    """Return the numerical checks of a motion: dynamics, velocity, ends, closures, integrated state, pin forces."""
    mechanism, motion, when = plan.problem.mechanism, plan.problem.motion, certificate.worst_time_s
    kinds = {joint.kind for joint in mechanism.independent_joints}
    allowed_residual, residual = certificate.dynamics_allowed, certificate.dynamics_residual
    efforts = " or ".join(dict.fromkeys(joint.si_units[1] for joint in mechanism.independent_joints))
    # Planned efforts beyond a limit have a row of their own.
    carried = residual <= allowed_residual and not (certificate.needs_more and not certificate.effort_excess)
    velocity_kept = not any(failure.startswith(_NOT_ITS_VELOCITY) for failure in certificate.failures)
    allowed_slope = VELOCITY_SHARE if plan.trajectory is None else plan.trajectory.slope_share
    ends = "error at start and goal, relative to the range or the largest speed"
    # label, passed, worst, limit, unit, time of the worst value
    rows: list[tuple] = [
        ("effort by inverse dynamics minus the planned effort", carried, residual,
         allowed_residual, efforts, when.get("dynamics_residual")),
        ("velocity minus the derivative of the position", velocity_kept, 100 * certificate.velocity_residual,
         100 * allowed_slope, "%", when.get("velocity_residual")),
        (ends, certificate.boundary_error <= BOUNDARY_SHARE, certificate.boundary_error, BOUNDARY_SHARE, "", None),
    ]  # fmt: skip
    if motion.tasks:
        allowed, error = BOUNDARY_SHARE * mechanism.extent_m, certificate.site_error_m
        label = f"error of {task_words(motion.tasks)} at start, waypoints and goal"
        rows.append((label, error <= allowed, error, allowed, "m", None))
    if mechanism.closures:
        allowed = max(CLOSURE_M, mechanism.closed_m)
        held, at = certificate.largest_gap_m <= allowed, when.get("closure_gap_m")
        for unit, gap in certificate.closure_gaps.items():
            limit = allowed / max(closure.per_unit for closure in mechanism.closures if closure.unit == unit)
            rows.append(("gap of the kinematic loops", held, gap, limit, unit, at))
    for kind, error, allowed, unit in (
        ("hinge", certificate.integration_error_deg, INTEGRATION_DEG, "deg"),
        ("slide", certificate.integration_error_m, INTEGRATION_M, "m"),
    ):
        if kind in kinds:
            label = "state integrated under the planned effort, minus the planned state"
            rows.append((label, error <= allowed, error, allowed, unit, None))
    items = [_item(*row) for row in rows]
    items = [replace(item, worst=_digits(item.worst), limit=_digits(item.limit)) for item in items]
    if mechanism.closures:
        what = "least det J_z, relative to home (0 at a singular pose)"
        items.append(_item(what, None, certificate.singularity_ratio, None, "", None))
    limited = [margin.name for margin in certificate.margins if margin.what == "closure_force"]
    forces = zip(mechanism.closure_names, certificate.peak_closure_force, strict=True)
    rest = [(name, force) for name, force in forces if name not in limited]
    return [*items, *(_item(f"closure force of {name}", None, force, None, "N", None) for name, force in rest)]


def _contacts(plan: Plan, certificate: Certificate) -> list[Item]:
    return [
        _item(
            f"contact of {geom_names(meeting)}, depth",
            plan.problem.limits.contacts != "refuse" or meeting.since_s is None,
            1e3 * meeting.depth_m,
            0.0 if plan.problem.limits.contacts == "refuse" and meeting.since_s is not None else None,
            "mm",
            meeting.deepest_at_s,
        )
        for meeting in certificate.contacts
    ]


def _digits(value: float | None) -> float | None:
    """Return two digits of an error; zero for rounding errors."""
    return significant(0.0 if value is not None and abs(value) < 1e-14 else value, 2)


def _item(label: str, passed: bool | None, worst: float, limit: float | None, unit: str, at: float | None) -> Item:
    return Item(
        label=label,
        passed=None if passed is None else bool(passed),
        worst=significant(worst, 5),
        limit=significant(limit, 6),
        unit=unit,
        instant_s=None if at is None else float(f"{at:.7g}"),
    )
