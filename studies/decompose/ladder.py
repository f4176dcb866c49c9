"""The ladder from the ideal feedback loop to the real one: what is switched on, and the error that is left on each rung.

The first rungs stand on the rigid kinematic loop, the reduced dynamics integrated tightly; the later ones in MuJoCo, on
machines with more and more of their imperfections. What is switched on stays on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections, Machine
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference, sample, state_at
from linkplan.controllers.rigid_plant import RigidPlant
from linkplan.controllers.simulate import Plant, simulate
from linkplan.controllers.trackers.stepping import steps_of
from linkplan.controllers.trackers.tracker import AnyTracker, TrackerWithMemory
from linkplan.models.errors import ProblemError
from linkplan.studies.compare.compare import build_tracker
from linkplan.studies.compare.user_tracker import Asked
from linkplan.studies.experiment.experiment import Experiment

RUNGS: Mapping[str, str] = {
    "plan": "discretisation of the plan",
    "law": "feedforward that the tracker lacks",
    "sampling": "sampling and delay",
    "simulator": "simulator: soft loops and integration",
    "devices": "sensors and drives",
    "model": "model error: masses, lengths, friction, start, pushes",
    "limits": "effort limits",
}
"""What is switched on, in this order."""

# Continuous control is stood for by control periods that are so many times shorter.
FINER = 5
# A feedforward that is complete to this share of the largest effort, at so many instants, lacks nothing.
_COMPLETE, _LOOKED_AT = 1e-9, 33


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Ladder:
    """One tracker's errors s_ref - s (n_rungs, t, n, n_s) [rad or m] on the rungs, and why a machine has none."""

    tracker: str
    errors: np.ndarray
    failure: tuple[str | None, ...]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Completed:
    """A law with the efforts (t, n_u) [N.m or N] added that it lacks on the reference itself."""

    law: TrackerWithMemory
    lacking: np.ndarray

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return the law's memory before the first instant."""
        return self.law.start(n)

    def step(self, k: int, position: np.ndarray, velocity: np.ndarray, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the law's next memory."""
        effort, after = self.law.step(k, position, velocity, memory)
        return effort + self.lacking[k], after


def climb(experiment: Experiment, asked: Asked) -> Ladder:
    """Return a tracker's errors on all rungs of a plan's ladder, for all machines of an experiment.

    Raises:
        ProblemError: for a tracker that cannot be had at another control period.
    """
    plan, reference, loop = experiment.plan, experiment.reference, experiment.loop
    mechanism, n = plan.problem.mechanism, experiment.n
    machines = [experiment.machine(i) for i in range(n)]
    law = build_tracker(asked, plan, reference)
    free = _unlimited(law)
    limited = MujocoPlant(mechanism=mechanism, loop=loop)
    infinite = np.tile([-np.inf, np.inf], (mechanism.n_u, 1))
    unlimited = MujocoPlant(mechanism=mechanism, loop=replace(loop, effort_limit=infinite))
    rigid = RigidPlant(mechanism=mechanism, delay_periods=loop.delay_periods)
    failure: list[str | None] = [None] * n
    clocked = [Imperfections(clock=one.clock) for one in _alike(machines)]
    found = [*_ideal(experiment, asked), _errors(rigid, free, reference, clocked)]
    groups = {_GROUPS.get(factor.key, "model") for factor in experiment.section.factors}
    for rung, plant, tracker in (
        ("simulator", unlimited, free),
        ("devices", unlimited, free),
        ("model", unlimited, free),
        ("limits", limited, law),
    ):
        if rung in ("devices", "model") and rung not in groups:
            found.append(found[-1])
        else:
            these = [_stripped(one, rung) for one in (_alike(machines) if rung == "simulator" else machines)]
            found.append(_errors(plant, tracker, reference, these))
    for rung, (_, failed) in zip(RUNGS, found, strict=True):
        for i in range(n):
            said = failed[i if len(failed) > 1 else 0]
            if failure[i] is None and said is not None:
                failure[i] = f"lost when {RUNGS[rung].partition(':')[0]} came in: {said}"
    t, n_s = reference.position.shape
    errors = np.array([np.broadcast_to(error, (t, n, n_s)) for error, _ in found])
    return Ladder(tracker=law.name, errors=errors, failure=tuple(failure))


# Errors (t, n or 1, n_s), and why each run failed.
_Found = tuple[np.ndarray, Sequence[str | None]]
# What the keys of [imperfections] belong to; all others are the model's errors.
_GROUPS = {
    **dict.fromkeys(("period_factor", "phase_periods", "delay_periods"), "sampling"),
    **dict.fromkeys(("loop_time_constant_s", "loop_damping_ratio"), "simulator"),
    **dict.fromkeys(
        (
            *(f"encoder_{what}_{unit}" for what in ("resolution", "offset") for unit in ("deg", "m")),
            *("position_noise_deg", "position_noise_m", "velocity_noise_deg_s", "velocity_noise_m_s"),
            *("velocity_filter_hz", "torque_resolution", "torque_bandwidth_hz", "torque_rate", "torque_constant_factor"),
        ),
        "devices",
    ),
}


def _stripped(machine: Imperfections, rung: str) -> Imperfections:
    """Return a machine with those imperfections that are switched on by a rung in MuJoCo."""
    stiffness = Machine(loop_solref=machine.machine.loop_solref)  # the simulator's own softness, if another is asked for
    if rung in ("simulator", "devices"):
        machine = replace(machine, machine=stiffness)
    kept = {
        "simulator": ("clock", "machine"),
        "devices": ("clock", "machine", "sensors", "drives"),
        "model": tuple(field.name for field in fields(Imperfections)),
        "limits": tuple(field.name for field in fields(Imperfections)),
    }[rung]
    return Imperfections(**{name: getattr(machine, name) for name in kept})


def _ideal(experiment: Experiment, asked: Asked) -> list[_Found]:
    """Return the errors of the ideal loop, on rigid loops at very short periods: with what it lacks, and as it is."""
    plan, coarse = experiment.plan, experiment.reference
    mechanism, T = plan.problem.mechanism, coarse.period_s
    fine = sample(mechanism, plan.trajectory, T / FINER, coarse.n * T)
    law = _unlimited(_rebuilt(experiment, asked, fine))
    whole, found = completed(law, fine), []
    for one in (law,) if whole is law else (whole, law):
        runs = simulate(RigidPlant(mechanism=mechanism), one, fine)
        found.append((coarse.position[:, None] - runs.pose[::FINER][:, :, mechanism.independent], runs.failure))
    return [found[0], found[-1]]


def _rebuilt(experiment: Experiment, asked: Asked, reference: SampledReference) -> AnyTracker:
    if not isinstance(asked, str) and not isinstance(asked, type) and callable(getattr(asked, "effort", None)):
        raise ProblemError(
            "a tracker whose error is decomposed runs at shorter control periods too: a name or a function of the sampled"
            f" reference that returns a law, got a law of one reference, {asked!r}"
        )
    return build_tracker(asked, experiment.plan, reference)


def completed(law: AnyTracker, reference: SampledReference) -> AnyTracker:
    """Return a law with the feedforward that it lacks: one that lacks none, at a few instants, stays as it is."""
    steps = steps_of(law)
    memory, position, velocity = steps.start(1), reference.position, reference.velocity

    def lacking(instants: np.ndarray) -> np.ndarray:
        own = [steps.step(int(k), position[k, None], velocity[k, None], memory)[0][0] for k in instants]
        return reference.effort[instants] - np.array(own)

    few = np.unique(np.linspace(0, reference.n - 1, _LOOKED_AT).astype(int))
    if np.abs(lacking(few)).max() <= _COMPLETE * np.abs(reference.effort).max():
        return law
    return Completed(law=steps, lacking=lacking(np.arange(reference.n)))


def _unlimited(law: AnyTracker) -> AnyTracker:
    """Return a law that knows effort limits without them."""
    if not is_dataclass(law) or not hasattr(law, "effort_limit"):
        return law
    limit = np.asarray(law.effort_limit)
    return replace(law, effort_limit=np.broadcast_to([-np.inf, np.inf], limit.shape))


def _alike(machines: Sequence[Imperfections]) -> Sequence[Imperfections]:
    """Return the first machine alone where all have its clock and softness: until something else comes in they are one."""
    known = {(one.machine.loop_solref, *(getattr(one.clock, field.name) for field in fields(Clock))) for one in machines}
    return machines[:1] if len(known) == 1 else machines


def _errors(plant: Plant, law: AnyTracker, reference: SampledReference, machines: Sequence[Imperfections]) -> _Found:
    """Return the errors of machines at their own times."""
    ran = simulate(plant, law, reference, machines)
    return state_at(reference, ran.time_s)[0] - ran.pose[:, :, plant.mechanism.independent], ran.failure
