"""A certificate as a checklist: every limit with its worst number and the instant at which it is worst."""

from dataclasses import replace

import numpy as np

from linkplan.models.tree.joints import Joint
from linkplan.planner.certificate.certificate import (
    BOUNDARY_SHARE,
    CLOSURE_M,
    INTEGRATION_M,
    RANGE_SLACK,
    VELOCITY_SHARE,
    Certificate,
)
from linkplan.planner.certificate.collisions import geom_names
from linkplan.planner.keys.kinds import INTEGRATION_DEG
from linkplan.planner.plan import Plan
from linkplan.studies.report.document import Checklist, Item
from linkplan.studies.report.motion import Motion

# Digits of a residual: its size is what is known of it.
_RESIDUAL = 2
# What a certificate's sentence on the velocity begins with: its verdict looks at the integrated velocity, too.
_NOT_ITS_VELOCITY = "the planned velocity is not"


def certificate_list(plan: Plan, motion: Motion, group: str) -> Checklist:
    """Return the checklist of a plan's certificate, its instants those of the cursor `group`."""
    certificate = plan.certificate
    items = [
        *_efforts(plan, motion),
        *_ranges(plan, motion),
        *_margins(certificate),
        *_numerics(plan, certificate),
        *_contacts(plan, certificate),
    ]
    return Checklist(title="What holds between the nodes", group=group, items=items)


def _efforts(plan: Plan, motion: Motion) -> list[Item]:
    items = []
    for j, actuator in enumerate(plan.problem.mechanism.actuators):
        values, (low, high) = motion.effort[:, j], plan.problem.limits.effort[j]
        inside = np.minimum(values - low, high - values)
        at = int(np.argmin(inside)) if np.isfinite(inside).any() else int(np.argmax(np.abs(values)))
        limit = high if high - values[at] <= values[at] - low else low
        over = inside.min() < 0 and plan.certificate.effort_excess > 0
        items.append(
            _item(f"effort of {actuator.name}", not over, values[at], limit, actuator.unit, _instant(motion.time_s[at]))
        )
    return items


def _ranges(plan: Plan, motion: Motion) -> list[Item]:
    """Return the joints' ranges and speed limits: the value that comes nearest to its limit, and that limit."""
    problem, certificate, items = plan.problem, plan.certificate, []
    kinds = (
        ("range", "", motion.pose, problem.limits.position, certificate.position_margin),
        ("speed limit", "/s", motion.rates, problem.limits.speed, certificate.speed_margin),
    )
    for what, per, values, bounds, margins in kinds:
        for k, joint in enumerate(problem.mechanism.joints):
            if not np.isfinite(margins[k]):
                continue
            low, high = bounds[k]
            at = int(np.argmin(np.minimum(values[:, k] - low, high - values[:, k])))
            upper = high - values[at, k] <= values[at, k] - low
            limit = high if upper else low
            value = limit - margins[k] if upper else limit + margins[k]
            passed = bool(margins[k] >= -RANGE_SLACK)
            when = certificate.worst_time_s.get(f"{what} of {joint.name}")
            unit = f"{joint.unit}{per}"
            items.append(_item(f"{what} of {joint.name}", passed, _shown(joint, value), _shown(joint, limit), unit, when))
    return items


def _shown(joint: Joint, value: float) -> float:
    return joint.shown(float(value))


def _margins(certificate: Certificate) -> list[Item]:
    return [
        _item(margin.title, margin.kept, margin.value, margin.limit, margin.unit, margin.time_s)
        for margin in certificate.margins
    ]


def _numerics(plan: Plan, certificate: Certificate) -> list[Item]:
    """Return what makes the motion one of the mechanism: dynamics, closure, ends, and the integrated state."""
    mechanism, when, residual = plan.problem.mechanism, certificate.worst_time_s, certificate.dynamics_residual
    share = float(certificate.residual_share.max(initial=0.0))
    units = " or ".join(dict.fromkeys("N.m" if joint.kind == "hinge" else "N" for joint in mechanism.independent_joints))
    dynamics = _item(
        "effort by inverse dynamics less the planned one",
        share <= 1.0,
        residual,
        residual / share if share > 0 else None,
        units,
        when.get("dynamics_residual"),
    )
    stray = any(failure.startswith(_NOT_ITS_VELOCITY) for failure in certificate.failures)
    items = [
        dynamics,
        _item(
            "velocity less the position's slope, of the largest speed",
            not stray,
            100 * certificate.velocity_residual,
            100 * VELOCITY_SHARE,
            "%",
            when.get("velocity_residual"),
        ),
        _item(
            "ends of the motion, off what is asked, of its range or largest speed",
            certificate.boundary_error <= BOUNDARY_SHARE,
            certificate.boundary_error,
            BOUNDARY_SHARE,
            "",
            None,
        ),
    ]
    motion = plan.problem.motion
    if motion.start_at or motion.goal_at or any(waypoint.at for waypoint in motion.waypoints):
        allowed = BOUNDARY_SHARE * mechanism.extent_m
        error = certificate.site_error_m
        items.append(_item("sites, off where they are asked to be", error <= allowed, error, allowed, "m", None))
    if mechanism.closures:
        allowed = max(CLOSURE_M, mechanism.closed_m)
        held, at = certificate.closure_gap_m <= allowed, when.get("closure_gap_m")
        for unit, gap in certificate.closure_gaps.items():
            one = allowed / max(closure.per_unit for closure in mechanism.closures if closure.unit == unit)
            items.append(_item("gap of the kinematic loops", held, gap, one, unit, at))
    kinds = {joint.kind for joint in mechanism.independent_joints}
    for kind, error, allowed, unit in (
        ("hinge", certificate.integration_error_deg, INTEGRATION_DEG, "deg"),
        ("slide", certificate.integration_error_m, INTEGRATION_M, "m"),
    ):
        if kind in kinds:
            what = "state integrated under the planned effort, off the planned one"
            items.append(_item(what, bool(error <= allowed), error, allowed, unit, None))
    items = [replace(item, worst=_known(item.worst, _RESIDUAL), limit=_known(item.limit, _RESIDUAL)) for item in items]
    if mechanism.closures:
        what = "least det J_z, relative to home (0 at a singular pose)"
        items.append(_item(what, True, certificate.singularity_ratio, None, "", None))
    return items


def _contacts(plan: Plan, certificate: Certificate) -> list[Item]:
    return [
        _item(
            f"contact of {geom_names(meeting)}, depth",
            plan.problem.contacts != "refuse" or meeting.since is None,
            1e3 * meeting.depth_m,
            0.0 if plan.problem.contacts == "refuse" and meeting.since is not None else None,
            "mm",
            meeting.deepest_at,
        )
        for meeting in certificate.contacts
    ]


def _item(label: str, passed: bool, worst: float, limit: float | None, unit: str, at: float | None) -> Item:
    return Item(
        label=label,
        passed=bool(passed),
        worst=_known(worst, 5),
        limit=_known(limit),
        unit=unit,
        instant_s=None if at is None else _instant(at),
    )


def _known(value: float | None, digits: int = 6) -> float | None:
    return float(f"{value:.{digits}g}") if value is not None and np.isfinite(value) else None


def _instant(time: float) -> float:
    return float(f"{time:.7g}")
