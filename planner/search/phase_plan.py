"""The plan of a motion in phases from its solution: a plan of each phase in the world's coordinates, and the junctions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.whole_body import (
    centre_of_mass,
    centre_velocity,
    fall_acceleration,
    total_mass,
    unit_acceleration,
)
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.certificate.further_checks import objective_value
from linkplan.planner.closed_chain.case import case_of, finished
from linkplan.planner.limits.samples import samples_of
from linkplan.planner.plan.phased import Junction, PhasedRecord, PhaseQuantities, PhaseRow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.plan.verdict import Verdict, failed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.case import CertifiedIterate, Iterate
from linkplan.planner.search.finer_meshes import Kept, along_ranges, is_sound, repaired
from linkplan.planner.search.phase_set import PhaseSet, problem_between
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.linked import Linked

# A smaller impulse [N s] is rounding, and so is this share of the largest one.
_LEAST_IMPULSE, _ROUNDING_SHARE = 1e-9, 1e-6
# The duration of a phase that is corrected stays within this share.
_SAME_DURATION = 1e-9

Impulses = dict[str, tuple[float, float, float]]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PhasedMotion:
    """A solution of all phases: their iterates, the unknowns of the links, and the objective [SI]."""

    found: tuple[Iterate, ...]
    linked: Linked
    own: tuple[np.ndarray, ...]
    objective: float


def phased_plan(of: PhaseSet, at: PhasedMotion, certified: Sequence[CertifiedIterate], settled: bool) -> PhasedRecord:
    """Return the plan of a solution with the certificates of its phases; `settled` if its objective has settled."""
    origin, plans, moves = np.zeros(of.first.n_q), [], _moves(of, at)
    for k, one in enumerate(certified):
        plans.append(_plan_of(of, k, one, origin))
        origin = origin + moves[k] if k < len(moves) else origin
    junctions, body = _junctions(of, at, moves), _body(of, plans)
    verdict = _verdict(of, plans, junctions, settled)
    begins = np.cumsum([0.0, *(one.found.motion.duration_s for one in certified)]).tolist()
    rows = [
        PhaseRow(
            name=asked.name,
            on=tuple(asked.on),
            begins_s=begin,
            duration_s=plan.duration_s,
            status=plan.status,
            objective=plan.objective,
            message=plan.message,
        )
        for asked, plan, begin in zip(of.asked.phases, plans, begins, strict=False)
    ]
    return PhasedRecord(
        problem=of.asked.name,
        tables=of.asked.to_dict(),
        verdict=verdict,
        objective=_objective(of, plans, body) if verdict.passed else None,
        duration_s=begins[-1],
        phases=tuple(rows),
        junctions=tuple(junctions),
        body=body,
        plans=tuple(plans),
    )


def _verdict(of: PhaseSet, plans: Sequence[Plan], junctions: Sequence[Junction], settled: bool) -> Verdict:
    """Return the verdict on the whole motion."""
    for phase, plan in zip(of.phases, plans, strict=True):
        if not plan.passed:
            return failed(f"phase {phase.name}: {plan.verdict.words}", "certificate", known_by="certificate")
    faults = [one.fault for one in junctions if one.fault]
    if faults:
        return failed(faults[0], "certificate", known_by="certificate")
    duration = sum(plan.duration_s or 0.0 for plan in plans)
    several = f" in {len(plans)} phases" if len(plans) > 1 else ""
    minimized = plans[0].problem.objective.name if of.asked.sections.objective.maximize is None else ""
    return Verdict(
        kind="optimal" if settled else "feasible",
        words=f"motion of {duration:.6g} s{several}",
        objective=minimized if settled else "",
        further=tuple(one.note for one in junctions if one.note),
    )


def _objective(of: PhaseSet, plans: Sequence[Plan], body: PhaseQuantities | None) -> float:
    """Return the objective [SI]: the weighted sum of the phases' own, or the height and the distance."""
    maximize = of.asked.sections.objective.maximize
    if maximize is None or body is None:
        pairs = zip(of.asked.phases, plans, strict=True)
        return float(sum(phase.weight * (plan.objective or 0.0) for phase, plan in pairs))
    heights = {None: 0.0, "apex": body.apex_m, "end": body.com_end_m[2]}
    return heights[maximize.com_height] + (body.com_end_m[0] if maximize.distance else 0.0)


def _moves(of: PhaseSet, at: PhasedMotion) -> list[np.ndarray]:
    """Return how far the origin of all coordinates (n_q,) moves at each junction, that of a gait included [m]."""
    found = []
    for k in range(len(of.phases) - (not of.asked.sections.motion.repeat)):
        moved = np.zeros(of.first.n_q)
        for number, slide in enumerate(of.at.slides[k]):
            moved[slide] = at.own[k][of.first.n_q + number] * of.first.extent_m
        found.append(moved)
    return found


def with_ends(problem: Problem, motion: Trajectory, *, timed: bool = False) -> Problem:
    """Return a problem that asks for the ends of a motion, and for its duration if `timed`."""
    times = np.array([0.0, motion.duration_s])
    (start, goal), (start_speed, goal_speed) = motion.position_at(times), motion.velocity_at(times)
    states = {"start": start, "goal": goal, "start_speed": start_speed, "goal_speed": goal_speed}
    changed = replace(problem.motion, **states, goal_named=tuple(range(problem.mechanism.dof)))
    if timed:
        low, high = motion.duration_s * (1.0 - _SAME_DURATION), motion.duration_s * (1.0 + _SAME_DURATION)
        changed = replace(changed, duration_s=None, min_duration_s=low, max_duration_s=high)
    return problem.varied(motion=changed)


def _plan_of(of: PhaseSet, k: int, at: CertifiedIterate, origin: np.ndarray) -> Plan:
    """Return the plan of one phase, whose own origin is at `origin` (n_q,) in the world; it is corrected if it must be."""
    phase = of.phases[k]
    if not is_sound(at.certificate):
        fixed = with_ends(phase.problem, at.found.motion, timed=phase.problem.motion.duration_s is None)
        mesh = phase.problem.mesh.replace(scheme=at.found.solution.transcribed.scheme.name)
        case = replace(phase.case, problem=fixed.varied(mesh=mesh), asked=fixed, free_ends=None)
        at = repaired(Kept(case, at, along_ranges(fixed, at.found.motion)))
    motion, mechanism = at.found.motion, phase.mechanism
    place = centre_of_mass(mechanism)
    way = np.array(place(mechanism.home + origin) - place(mechanism.home)).ravel()
    stand = {site: np.concatenate([at_m[:3] + way, at_m[3:]]) for site, at_m in of.at.stand[k].items()}
    position = motion.position + origin[mechanism.independent]
    world = replace(motion, position=position, start_pose=motion.start_pose + origin)
    times = np.array([0.0, motion.duration_s])
    ends = np.tile(world.start_pose, (2, 1))
    ends[:, mechanism.independent] = world.position_at(times)
    loaded = mechanism if not np.any(origin) else None
    problem = problem_between(of.asked, k, stand, ends, loaded, speeds=motion.velocity_at(times))
    certificate = case_of(problem.varied(solver=phase.problem.solver)).certify(world)
    if certificate is None:
        return Plan(problem=problem, verdict=failed("the motion leaves its branch", "certificate", known_by="certificate"))
    return finished(problem, world, certificate, objective_value(problem, world)[0], None)


def _junctions(of: PhaseSet, at: PhasedMotion, moves: Sequence[np.ndarray]) -> list[Junction]:
    """Return what happens between the phases."""
    n, found = len(of.phases), []
    times = np.cumsum([one.motion.duration_s for one in at.found])
    for k, moved in enumerate(moves):
        j = (k + 1) % n
        repeats = j <= k
        before, after = of.asked.phases[k].on, of.asked.phases[j].on
        impulses, lost = _impact(of, at, k, j, moved)
        pulls, slips = _impulse_faults(of, j, impulses)
        found.append(
            Junction(
                time_s=float(times[k]),
                released=tuple(one for one in before if one not in after or repeats),
                touched=tuple(one for one in after if one not in before or repeats),
                impulse_ns=impulses,
                energy_lost_j=lost,
                moved_m={of.first.joints[i].name: float(moved[i]) for i in np.flatnonzero(moved)},
                fault=pulls,
                note=slips,
            )
        )
    return found


def _impact(of: PhaseSet, at: PhasedMotion, k: int, j: int, moved: np.ndarray) -> tuple[Impulses, float]:
    """Return the impulses on the sites that stand after a junction [N s], and the energy that is lost [J]."""
    first, second = of.phases[k].mechanism, of.phases[j].mechanism
    q = at.own[k][: first.n_q] * unit_steps(first.joints, first.extent_m)
    order = of.exchange(k).order
    q_2 = q[order] - moved
    end, start = at.found[k].motion, at.found[j].motion
    v = (np.array(first.dynamics.velocity_map(q)) @ end.velocity_at(np.array([end.duration_s]))[0])[order]
    v_2 = np.array(second.dynamics.velocity_map(q_2)) @ start.velocity_at(np.zeros(1))[0]
    M, M_2 = (np.array(one.dynamics.mass_matrix(q_2)) for one in (of.inertia(k, j), second))
    J = np.array(second.dynamics.closure_jacobian(q_2)).reshape(-1, first.n_q)
    rows = np.linalg.lstsq(J.T, M_2 @ v_2 - M @ v, rcond=1e-9)[0] if len(J) else np.zeros(0)
    impulses = {}
    for c, name in enumerate(second.closure_names):
        if name in of.at.stand[j]:
            x, y, z = rows[second.closure_slice(c)].tolist()
            impulses[name] = (x, y, z)
    return impulses, float(0.5 * (v @ M @ v - v_2 @ M_2 @ v_2))


def _impulse_faults(of: PhaseSet, j: int, impulses: Impulses) -> tuple[str, str]:
    """Return what is wrong with the impulses of a touch-down: that one pulls, and that one leaves the friction cone."""
    largest = max((float(np.linalg.norm(one)) for one in impulses.values()), default=0.0)
    pulls, slips, where = "", "", f"at the start of phase {of.phases[j].name}"
    for contact in of.asked.phases[j].on if largest > _LEAST_IMPULSE else ():
        friction = of.asked.sections.contacts[contact].friction
        for site in of.asked.sites_of(contact):
            normal, impulse = of.at.stand[j][site][3:], np.array(impulses[site])
            push = float(normal @ impulse)
            slip, rounding = float(np.linalg.norm(impulse - push * normal)), _ROUNDING_SHARE * largest
            if push < -rounding:
                pulls = pulls or f"{where} the ground would have to pull {site} by {-push:.4g} N s"
            elif friction is not None and slip > friction * push + rounding:
                slips = slips or (
                    f"{where} {site} slips: its impulse needs a friction of {slip / max(push, 1e-300):.4g}, more than"
                    f" {friction:g}"
                )
    return pulls, slips


def _body(of: PhaseSet, plans: Sequence[Plan]) -> PhaseQuantities | None:
    """Return what the motion does with the centre of mass; None without a motion."""
    first, last = plans[0], plans[-1]
    if first.trajectory is None or last.trajectory is None:
        return None
    mechanism = last.problem.mechanism
    place, end = _places(first.problem.mechanism, first.trajectory)[0], _places(mechanism, last.trajectory)[1]
    pose = follow(mechanism, last.trajectory.position_at(last.trajectory.dense_times()), last.trajectory.start_pose)[-1:]
    rates = joint_rates(mechanism, pose, last.trajectory.velocity_at(np.array([last.trajectory.duration_s])))[0]
    velocity = np.array(centre_velocity(mechanism)(pose[0], rates)).ravel()
    distance = float(end[0] - place[0])
    fall = fall_acceleration(mechanism)
    apex = float(end[2] + (max(velocity[2], 0.0) ** 2 / (2 * fall) if fall else 0.0))
    return PhaseQuantities(
        com_start_m=_three(place),
        com_end_m=_three(end),
        com_velocity_end_m_s=_three(velocity),
        apex_m=apex,
        distance_m=distance,
        cost_of_transport=_cost_of_transport(plans, distance) if of.asked.sections.motion.repeat else None,
    )


def _places(mechanism: Mechanism, motion: Trajectory) -> np.ndarray:
    """Return the places (2, 3) of the centre of mass at the ends of a motion."""
    poses = follow(mechanism, motion.position_at(motion.dense_times()), motion.start_pose)
    return np.array([np.array(centre_of_mass(mechanism)(q)).ravel() for q in poses[[0, -1]]])


def _three(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def _cost_of_transport(plans: Sequence[Plan], distance_m: float) -> float | None:
    """Return the positive work of the actuators over weight and distance; None without a distance."""
    mechanism, work = plans[0].problem.mechanism, 0.0
    for plan in plans:
        if plan.trajectory is not None:
            at = samples_of(plan.problem, plan.trajectory)
            work += float(np.trapezoid(np.maximum(at.u * at.actuator_speeds, 0.0).sum(axis=1), at.time))
    least = 1e-9 * mechanism.extent_m
    return work / (unit_acceleration(mechanism) * total_mass(mechanism) * distance_m) if distance_m > least else None
