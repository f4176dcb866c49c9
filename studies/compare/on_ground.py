"""Trackers on a motion in phases in MuJoCo, with real contacts: one law for all phases, and what the run does."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.phases.ground_plant import Foot, GroundPlant
from linkplan.controllers.phases.jumps import End, cycle_map, jump, through_phases
from linkplan.controllers.phases.law import Exchanged, PhasedLaw, Stage
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.simulate import Ensemble, simulate
from linkplan.controllers.trackers.tracker import StateFeedback, steps_of
from linkplan.models.errors import ProblemError
from linkplan.models.ground import ground_of
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import joint_rates
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.whole_body import fall_acceleration
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.build import mechanism_from_tables, parameters_of, table_of
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.search.phase_poses import mirror_of
from linkplan.studies.compare.compare import Mismatch, build_tracker, control_loop, design_of
from linkplan.studies.compare.user_tracker import TrackerLike

# How often a gait is repeated, unless tracking.duration_s says how long it is tracked.
_USUAL_REPETITIONS = 5
# Fewest control instants of a phase: with fewer, a law hardly acts in it.
_FEWEST_INSTANTS = 3
# A flight at the end is simulated until after its apex, by this share of the time to it.
_AFTER_APEX = 0.1


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GroundMotion:
    """A motion in phases at control instants, on the ground.

    Args:
        record: the plan.
        plans: of its phases.
        mechanism: without closures for its contacts.
        feet: its sites that touch the ground, those of exchanged legs included.
        on: (n_phases, n_feet) which of them stand in each phase.
        references: each phase at its control instants.
        whole: all joints at the control instants of the run, as planned.
        exchanged: of a gait.
    """

    record: PhasedRecord
    plans: tuple[Plan, ...]
    mechanism: Mechanism
    feet: tuple[Foot, ...]
    on: np.ndarray
    references: tuple[SampledReference, ...]
    whole: SampledReference
    exchanged: Exchanged | None


def ground_motion(record: PhasedRecord) -> GroundMotion:
    """Return a plan in phases, prepared for tracking on the ground.

    Raises:
        ProblemError: for phases with different payloads or closures, or too short for the control period.
    """
    asked = PhasedProblem.from_tables(record.problem, record.tables)
    if changes := [phase.name for phase in asked.phases if phase.open or phase.payload or phase.payload_kg is not None]:
        raise ProblemError(
            f"tracking on the ground needs the same payload and closures in all phases, and phase {changes[0]} changes them;"
            " track the folder of one phase"
        )
    standing = record.plans[0].problem.mechanism
    table = table_of(standing) | {"stand": asked.sections.mechanism.to_dict().get("stand"), "independent": None}
    tables = {"mechanism": {key: value for key, value in table.items() if value}}
    mechanism = mechanism_from_tables(tables | ({"parameters": named} if (named := parameters_of(standing)) else {}))
    order = mirror_of(asked, mechanism)
    feet, places = _feet(asked, mechanism, order)
    names = [foot.site for foot in feet]
    on = np.zeros((len(asked.phases), len(feet)), dtype=bool)
    for k, phase in enumerate(asked.phases):
        on[k, [names.index(site) for contact in phase.on for site in asked.sites_of(contact)]] = True
    references = _references(record)
    exchanged = None
    if asked.sections.motion.repeat:
        moved = np.zeros(mechanism.n_q)
        for joint, way in ((joint, way) for one in record.junctions for joint, way in one.moved_m.items()):
            moved[mechanism.joint_index(joint, ProblemError)] += way
        actuators = _exchanged_actuators(mechanism, order)
        exchanged = Exchanged(joints=order, actuators=actuators, feet=places, moved=moved)
    return GroundMotion(
        record=record,
        plans=record.plans,
        mechanism=mechanism,
        feet=feet,
        on=on,
        references=references,
        whole=_whole(record, mechanism, references, exchanged),
        exchanged=exchanged,
    )


def _feet(asked: PhasedProblem, mechanism: Mechanism, order: np.ndarray) -> tuple[tuple[Foot, ...], np.ndarray]:
    """Return the feet of all contacts and those of exchanged legs, and which foot each is after an exchange."""
    model, found = mechanism.model, {}
    for contact in asked.sections.contacts.values():
        ground = ground_of(model, contact.plane)
        for name in (contact.site,) if isinstance(contact.site, str) else contact.site:
            site = model.site(name)
            body = model.body(int(site.bodyid[0]))
            found[name] = Foot(site=name, body=body.name, place=site.pos.copy(), friction=contact.friction, ground=ground)
    after = {}
    for name, foot in list(found.items()):
        body = _exchanged_body(mechanism, model.body(foot.body).id, order)
        there = [model.site(k) for k in np.flatnonzero(model.site_bodyid == model.body(body).id)]
        same = [site.name for site in there if np.allclose(site.pos, foot.place)]
        other = same[0] if same else f"{name} of the other leg"
        found.setdefault(other, replace(foot, site=other, body=body))
        after[name], after[other] = other, name
    names = list(found)
    return tuple(found.values()), np.array([names.index(after[name]) for name in names], dtype=int)


def _exchanged_body(mechanism: Mechanism, body: int, order: np.ndarray) -> str:
    """Return the body that takes the part of a body after an exchange, by the joint that carries it."""
    model, joints = mechanism.model, [joint.name for joint in mechanism.joints]
    for index, name in enumerate(joints):
        if order[index] != index and int(model.joint(name).bodyid[0]) == body:
            return model.body(int(model.joint(joints[order[index]]).bodyid[0])).name
    return model.body(body).name


def _exchanged_actuators(mechanism: Mechanism, order: np.ndarray) -> np.ndarray:
    """Return the order (n_u,) of the actuators after an exchange of joints.

    Raises:
        ProblemError: if a driven joint exchanges its part with one that is not driven.
    """
    names, model = [joint.name for joint in mechanism.joints], mechanism.model
    driven = ["" if one.joint is None else model.joint(one.joint).name for one in mechanism.actuators]
    after = [names[order[names.index(name)]] if name in names else name for name in driven]
    if alone := [name for name in after if name not in driven]:
        raise ProblemError(f"motion.mirror: joint {alone[0]} takes the part of a driven joint and has no actuator")
    return np.array([driven.index(name) if name else k for k, name in enumerate(after)], dtype=int)


def _references(record: PhasedRecord) -> tuple[SampledReference, ...]:
    """Return each phase at the control instants of the whole motion that are in it.

    Raises:
        ProblemError: if a phase has too few.
    """
    period, found = record.plans[0].problem.tracking.period_s, []
    for phase, plan in zip(record.phases, record.plans, strict=True):
        motion = plan.require_motion("track")
        first, end = (int(np.ceil(t / period - 1e-9)) for t in (phase.begins_s, phase.begins_s + motion.duration_s))
        if end - first < _FEWEST_INSTANTS:
            raise ProblemError(
                f"tracking.period_s = {period:g} s gives phase {phase.name} of {motion.duration_s:.4g} s fewer than"
                f" {_FEWEST_INSTANTS} control instants"
            )
        begin, limits = first * period - phase.begins_s, plan.problem.limits.actuators_effort
        found.append(sample(plan.problem.mechanism, motion, period, (end - first) * period, limits, begin_s=max(0.0, begin)))
    return tuple(found)


def _whole(
    record: PhasedRecord, mechanism: Mechanism, references: Sequence[SampledReference], exchanged: Exchanged | None
) -> SampledReference:
    """Return all joints as planned at the control instants of a run: until the apex, or over the repetitions of a gait."""
    period, asked = references[0].period_s, record.plans[0].problem.tracking.duration_s
    pose = np.vstack([one.pose_rad for one in references])
    rates = [joint_rates(plan.problem.mechanism, one.pose_rad, one.velocity_rad_s)
             for plan, one in zip(record.plans, references, strict=True)]  # fmt: skip
    velocity, effort = np.vstack(rates), np.vstack([one.effort for one in references])
    n = len(pose)
    if exchanged is not None:
        many = round(asked / period) if asked else _USUAL_REPETITIONS * n
        views = []
        for r in range(-(-many // n)):
            odd = r % 2 == 1
            views.append((
                (pose[:, exchanged.joints] if odd else pose) + r * exchanged.moved,
                velocity[:, exchanged.joints] if odd else velocity,
                effort[:, exchanged.actuators] if odd else effort,
            ))  # fmt: skip
        pose, velocity, effort = (np.vstack([one[i] for one in views])[:many] for i in range(3))
    else:
        rise, fall = record.body.com_velocity_end_m_s[2] if record.body else 0.0, fall_acceleration(mechanism)
        more = 0 if asked is None else max(0, round(asked / period) - n)
        if not record.phases[-1].on and fall:
            more = max(more, int(np.ceil(max(rise, 0.0) / fall * (1.0 + _AFTER_APEX) / period)))
        kept = np.minimum(np.arange(n + more), n - 1)
        pose, velocity, effort = pose[kept], velocity[kept], effort[kept]
    return SampledReference(
        period_s=period,
        time_s=period * np.arange(len(pose)),
        pose_rad=pose,
        position_rad=pose,
        velocity_rad_s=velocity,
        effort=effort,
        cycle=None,
    )


def law_of(asked: TrackerLike, motion: GroundMotion) -> tuple[PhasedLaw, np.ndarray | None]:
    """Return a tracker of all phases, and the multipliers of a gait's errors over a repetition if the law is linear.

    Raises:
        ProblemError: for an unknown tracker.
        GainError: if there are no gains.
    """
    designs = [design_of(plan, one) for plan, one in zip(motion.plans, motion.references, strict=True)]
    jumps = jumps_of(motion) if asked == "lqr" or motion.exchanged is not None else []
    if asked == "lqr":
        laws = through_phases(designs, jumps)
    else:
        laws = [build_tracker(asked, plan, one) for plan, one in zip(motion.plans, motion.references, strict=True)]
    stages, n = [], len(laws)
    for k, (law, plan, reference) in enumerate(zip(laws, motion.plans, motion.references, strict=True)):
        after = motion.on[k + 1] if k + 1 < n else np.zeros(len(motion.feet), dtype=bool)
        if motion.exchanged is not None and k + 1 == n:
            after = motion.on[0][np.argsort(motion.exchanged.feet)]
        stages.append(
            Stage(
                law=steps_of(law),
                reference=reference,
                independent=plan.problem.mechanism.independent,
                touching=after & ~motion.on[k],
            )
        )
    multipliers = None
    linear = [law for law in laws if isinstance(law, StateFeedback)]
    if motion.exchanged is not None and len(linear) == n:
        period = motion.whole.period_s
        begins = [period * np.ceil(phase.begins_s / period - 1e-9) for phase in motion.record.phases]
        ends = [phase.begins_s + plan.duration_s for phase, plan in zip(motion.record.phases, motion.plans, strict=True)]
        cycle = cycle_map(designs, linear, jumps, [end - begin for begin, end in zip(begins, ends, strict=True)])
        multipliers = np.linalg.eigvals(cycle) if np.all(np.isfinite(cycle)) else None
    return PhasedLaw(name=laws[0].name, stages=tuple(stages), exchanged=motion.exchanged), multipliers


def jumps_of(motion: GroundMotion) -> list[np.ndarray]:
    """Return the maps of errors through the junctions, after the last phase of a gait too."""
    n, found = len(motion.plans), []
    for k in range(n if motion.exchanged is not None else n - 1):
        j = (k + 1) % n
        before, after = _end(motion.plans[k], -1), _end(motion.plans[j], 0)
        order, moved, stood = np.arange(motion.mechanism.n_q), np.zeros(motion.mechanism.n_q), motion.on[k]
        if j <= k:
            order, moved = motion.exchanged.joints, motion.exchanged.moved
            stood = stood[motion.exchanged.feet]
        touching = np.flatnonzero(motion.on[j] & ~stood)
        event = None
        if len(touching):
            foot = motion.feet[touching[0]]
            event = after.mechanism.model.site(foot.site).id, foot.ground[3:]
        found.append(jump(before, after, order, moved, event))
    return found


def _end(plan: Plan, end: int) -> End:
    """Return a plan's state at its start (0) or end (-1)."""
    motion, mechanism = plan.require_motion("track"), plan.problem.mechanism
    times = motion.dense_times()
    pose = follow(mechanism, motion.position_at(times), motion.start_pose)[end]
    at = times[[end]]
    return End(mechanism=mechanism, pose=pose, rates=motion.velocity_at(at)[0], effort=motion.effort_at(at)[0])


def run_on_ground(motion: GroundMotion, law: PhasedLaw, mismatch: Mismatch | None) -> Ensemble:
    """Return the log of a law on the machine on the ground; its velocities are followed by the feet's forces [N]."""
    loop = control_loop(motion.plans[0].problem, mismatch)
    plant = GroundPlant(mechanism=motion.mechanism, feet=motion.feet, loop=loop)
    log = simulate(plant, law, motion.whole)
    if log.error[0] is not None:
        raise log.error[0]
    return log
