"""The study behind `linkplan decompose`: the causes of each tracker's error on a plan.

A tracking error is a sum of its causes: signed parts that add up to the rms error.
Let e_1 to e_K be the errors after causes 1 to K are switched on, and e = e_K the total error. Let d_k be what cause k
adds, so that d_1 + ... + d_K = e: e_k - e_{k-1}, or its mean over several orders of the causes. Let <a, b> be the mean over
control instants and machines of the sum over joints of a b. The part of cause k is the projection of its increment on the
total error:

    p_k = <d_k, e> / rms,   rms = sqrt(<e, e>),   so that p_1 + ... + p_K = rms

exactly. A negative part reduces the error. The rms values of the increments, and the differences of rms values, do not add
up to the rms error, because errors of different causes can cancel or occur at different times.

The errors are those of a ladder from the ideal to the real feedback loop, whose steps each switch on one more cause. The
first steps simulate the rigid kinematic loop with accurately integrated reduced dynamics, the fourth the nominal machine in
MuJoCo. The last three causes (`SWITCHES`) interact: a payload causes little error until an effort limit is reached. All
combinations of them are simulated, and the increment of each is its mean over all orders (Shapley, A Value for n-Person
Games, 1953).
"""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

import numpy as np

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections, Machine
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference, sample, state_at
from linkplan.controllers.rigid_plant import RigidPlant
from linkplan.controllers.simulate import Plant, simulate
from linkplan.controllers.trackers.names import LINEAR
from linkplan.controllers.trackers.tracker import AnyTracker, TrackerWithMemory, steps_of
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.folders import plain_record
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import whole
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.compare import actuated_by_unit, build_tracker
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.variations.decompose.decomposition import Decomposition, Shares, TrackerShares
from linkplan.studies.variations.experiment.experiment import Experiment, Settings, experiment_of, imperfections_asked

CAUSES: Mapping[str, str] = {
    "plan": "discretisation of the plan",
    "law": "feedforward that the tracker lacks",
    "sampling": "sampling and delay",
    "simulator": "simulator: soft loops and integration",
    "devices": "sensors and drives",
    "model": "model error: masses, lengths, friction, start, pushes",
    "limits": "effort limits",
}
"""The causes in the order in which they are switched on."""
SWITCHES = ("devices", "model", "limits")

# Continuous control is approximated by a control period that is shorter by this factor.
_PERIOD_DIVISOR = 5
# A feedforward with a smaller relative error is complete.
_FEEDFORWARD_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Ladder:
    """One tracker's errors on the steps, and the reasons for failed machines.

    `errors` (n_steps, t, n, n_s): s_ref - s [rad or m] after each cause is switched on, in the order of `CAUSES`.
    `increments` (n_steps, t, n, n_s), one for each cause, add up to the last error; those of `SWITCHES` are means over their
    orders.
    """

    tracker: str
    errors: np.ndarray
    increments: np.ndarray
    failure: tuple[str | None, ...]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Completed:
    """A law plus the efforts (t, n_u) [N.m or N] that complete its feedforward on the reference."""

    law: TrackerWithMemory
    lacking: np.ndarray

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return the law's memory before the first instant."""
        return self.law.start(n)

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] for states (n, n_s), and the law's next memory."""
        effort, after = self.law.step(k, position_rad, velocity_rad_s, memory)
        return effort + self.lacking[k], after


def run_ladder(experiment: Experiment, asked: TrackerLike) -> Ladder:
    """Return a tracker's errors on all steps, for all machines of an experiment.

    Raises:
        ProblemError: for a tracker that cannot be built for another control period.
    """
    mechanism, reference, n = experiment.plan.problem.mechanism, experiment.reference, experiment.n
    machines = [experiment.machine(i) for i in range(n)]
    law = build_tracker(asked, experiment.plan, reference)
    rigid = RigidPlant(mechanism=mechanism, delay_periods=experiment.loop.delay_periods)
    clocked = [Imperfections(clock=one.clock) for one in _alike(machines)]
    groups = {_GROUPS.get(factor.key, "model") for factor in experiment.section.factors} | {"limits"}
    acting = [name for name in SWITCHES if name in groups]
    ran = _combinations(experiment, law, machines, acting)
    ideal = _ideal(experiment, asked)
    first = [*ideal, _errors(rigid, _unlimited(law), reference, clocked), ran[frozenset()]]
    after = [ran[frozenset(SWITCHES[:k]) & frozenset(acting)] for k in range(1, len(SWITCHES) + 1)]
    together = [(" and ".join(CAUSES[name].partition(":")[0] for name in names), ran[names]) for names in ran if names]
    failure = _failures([*zip(CAUSES.values(), [*first, *after], strict=True), *together], n)
    t, n_s = reference.position_rad.shape
    errors = np.array([np.broadcast_to(error, (t, n, n_s)) for error, _ in [*first, *after]])
    increments = np.diff(errors, axis=0, prepend=0.0)
    for row, name in enumerate(SWITCHES, start=len(first)):  # the mean over all orders of the acting causes
        increments[row] = 0.0
        for names in (names for names in ran if name in acting and name not in names):
            orders = math.factorial(len(names)) * math.factorial(len(acting) - len(names) - 1)
            increments[row] += orders / math.factorial(len(acting)) * (ran[names | {name}][0] - ran[names][0])
    return Ladder(tracker=law.name, errors=errors, increments=increments, failure=failure)


def _combinations(
    experiment: Experiment, law: AnyTracker, machines: Sequence[Imperfections], acting: Sequence[str]
) -> dict[frozenset[str], "_Found"]:
    """Return the errors of MuJoCo machines with each combination of the acting causes."""
    mechanism, loop = experiment.plan.problem.mechanism, experiment.loop
    infinite = np.tile([-np.inf, np.inf], (mechanism.n_u, 1))
    limited = MujocoPlant(mechanism=mechanism, loop=loop)
    unlimited = MujocoPlant(mechanism=mechanism, loop=replace(loop, effort_limit=infinite))
    found = {}
    for size in range(len(acting) + 1):
        for names in map(frozenset, itertools.combinations(acting, size)):
            these = [_with(one, names) for one in (machines if names - {"limits"} else _alike(machines))]
            plant, tracker = (limited, law) if "limits" in names else (unlimited, _unlimited(law))
            found[names] = _errors(plant, tracker, experiment.reference, these)
    return found


def _failures(runs: Sequence[tuple[str, "_Found"]], n: int) -> tuple[str | None, ...]:
    """Return the first reason for which each machine (n,) was lost, with the cause switched on at that step, or None."""
    failure: list[str | None] = [None] * n
    for words, (_, failed) in runs:
        for i in range(n):
            reason = failed[i if len(failed) > 1 else 0]
            if failure[i] is None and reason is not None:
                failure[i] = f"lost after {words.partition(':')[0]} was switched on: {reason}"
    return tuple(failure)


# Errors (t, n or 1, n_s), and the reason for each failed run.
_Found = tuple[np.ndarray, Sequence[str | None]]
# The group of each key of [imperfections]; keys without an entry are model errors.
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


def _with(machine: Imperfections, names: frozenset[str]) -> Imperfections:
    """Return a machine with its clock, the softness of its loops, and the causes of some names."""
    if "model" not in names:  # the softness of loops belongs to the simulator
        machine = replace(machine, machine=Machine(loop_solref=machine.machine.loop_solref))
    kept = {"clock", "machine"}
    kept |= {"sensors", "drives"} if "devices" in names else set()
    kept |= {"start", "pushes"} if "model" in names else set()
    return Imperfections(**{name: getattr(machine, name) for name in kept})


def _ideal(experiment: Experiment, asked: TrackerLike) -> list[_Found]:
    """Return the errors on rigid loops at a very short period: with a completed feedforward, and with the tracker's own."""
    if not isinstance(asked, str) and not isinstance(asked, type) and callable(getattr(asked, "effort", None)):
        raise ProblemError(
            "a decomposition also runs at a shorter control period: give a tracker's name, or a function of the sampled"
            f" reference that returns a law, instead of a law for one reference; got {asked!r}"
        )
    plan, coarse = experiment.plan, experiment.reference
    mechanism, T = plan.problem.mechanism, coarse.period_s
    limit = plan.problem.limits.actuators_effort
    fine = sample(mechanism, plan.require_motion("track"), T / _PERIOD_DIVISOR, coarse.n * T, limit)
    law = _unlimited(build_tracker(asked, plan, fine))
    whole, found = completed(law, fine), []
    for one in (law,) if whole is law else (whole, law):
        runs = simulate(RigidPlant(mechanism=mechanism), one, fine)
        found.append(
            (coarse.position_rad[:, None] - runs.pose[::_PERIOD_DIVISOR][:, :, mechanism.independent], runs.failure)
        )
    return [found[0], found[-1]]


def completed(law: AnyTracker, reference: SampledReference) -> AnyTracker:
    """Return a law with a completed feedforward; a law whose feedforward is already complete is returned unchanged."""
    steps = steps_of(law)
    memory, position, velocity = steps.start(1), reference.position_rad, reference.velocity_rad_s

    def lacking(instants: np.ndarray) -> np.ndarray:
        own = [steps.step(int(k), position[k, None], velocity[k, None], memory)[0][0] for k in instants]
        return reference.effort[instants] - np.array(own)

    few = np.unique(np.linspace(0, reference.n - 1, 33).astype(int))
    if np.abs(lacking(few)).max() <= _FEEDFORWARD_TOLERANCE * np.abs(reference.effort).max():
        return law
    return Completed(law=steps, lacking=lacking(np.arange(reference.n)))


def _unlimited(law: AnyTracker) -> AnyTracker:
    """Return a law without its effort limits, if it has any."""
    if not is_dataclass(law) or not hasattr(law, "effort_limit"):
        return law
    limit = np.asarray(law.effort_limit)
    return replace(law, effort_limit=np.broadcast_to([-np.inf, np.inf], limit.shape))


def _alike(machines: Sequence[Imperfections]) -> Sequence[Imperfections]:
    """Return only the first machine if all have the same clock and loop softness, and therefore equal errors so far."""
    known = {(one.machine.loop_solref, *(getattr(one.clock, field.name) for field in fields(Clock))) for one in machines}
    return machines[:1] if len(known) == 1 else machines


def _errors(plant: Plant, law: AnyTracker, reference: SampledReference, machines: Sequence[Imperfections]) -> _Found:
    """Return the machines' errors at their true times, and the reason for each failed run."""
    ran = simulate(plant, law, reference, machines)
    return state_at(reference, ran.time_s)[0] - ran.pose[:, :, plant.mechanism.independent], ran.failure


# Default and largest number of machines if something is random. For more machines, use an experiment.
DEFAULT_SAMPLES, MOST_SAMPLES = 16, 1000


def error_parts(errors: np.ndarray, increments: np.ndarray, joints: Sequence[str]) -> Shares:
    """Return the parts of errors e_K from e_1 to e_K and d_1 to d_K (K, t, n, n_s), by the names of causes and joints.

    t instants, n machines, n_s `joints` of one unit.
    """
    instants = errors.shape[1] * errors.shape[2]

    def rms_of(values: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(values**2, axis=(1, 2, 3)) / instants)

    def by_cause(values: np.ndarray) -> dict[str, float]:
        return dict(zip(CAUSES, values.tolist(), strict=True))

    rms = float(rms_of(errors[-1:])[0])
    projected = np.sum(increments * errors[-1], axis=(1, 2)) / instants
    of_joints = projected / rms if rms > 0 else np.zeros_like(projected)
    return Shares(
        rms_error=rms,
        parts=by_cause(of_joints.sum(axis=1)),
        parts_of_joints={name: by_cause(column) for name, column in zip(joints, of_joints.T, strict=True)},
        rms_of_increment=by_cause(rms_of(increments)),
        rms_error_on_rung=by_cause(rms_of(errors)),
    )


def decompose(
    plan: Plan,
    asked: Sequence[TrackerLike] = LINEAR,
    samples: int = DEFAULT_SAMPLES,
    seed: int = 0,
    say: Callable[[str], None] = silent,
) -> Decomposition:
    """Return the causes of the errors of trackers on a plan.

    Args:
        plan: with a motion, and the imperfections of its problem (default imperfections if it has none).
        asked: the trackers.
        samples: number of random machines; one machine if nothing is random.
        seed: of all random numbers.
        say: receives progress messages.

    Raises:
        ProblemError: for invalid imperfections or trackers, equal names, or no tracker.
        LinkplanError: for a mechanism that batches cannot simulate.
    """
    whole(samples, "samples", 1, MOST_SAMPLES)
    if not asked:
        raise ProblemError("a decomposition needs one or more trackers, got none")
    experiment = experiment_of(plan, Settings(samples=samples, seed=seed))
    if not any(factor.spread.random or "noise" in factor.key for factor in experiment.section.factors):
        experiment = replace(experiment, values=experiment.values[:1])
    found: dict[str, TrackerShares] = {}
    reference, mechanism = experiment.reference, plan.problem.mechanism
    for one in asked:
        ladder = run_ladder(experiment, one)
        if ladder.tracker in found:
            raise ProblemError(f"a decomposition needs trackers with different names, got '{ladder.tracker}' twice")
        kept = np.array([failed is None for failed in ladder.failure])
        errors, increments = ladder.errors[:, :, kept], ladder.increments[:, :, kept]
        say(f"{ladder.tracker}: {int(kept.sum())} of {len(kept)} machines")
        found[ladder.tracker] = TrackerShares(
            machines=int(kept.sum()),
            failures=dict(Counter(failed for failed in ladder.failure if failed is not None)),
            **(_by_unit(mechanism, errors, increments) if np.any(kept) else {}),
        )
    return Decomposition(
        decomposition=plan.problem.name,
        machines=experiment.n,
        seed=seed,
        imperfections=plain_record(imperfections_asked(plan)),
        control_period_s=reference.period_s,
        delay_periods=experiment.loop.delay_periods,
        timestep_s=min(reference.period_s, float(mechanism.model.opt.timestep)),
        duration_s=reference.period_s * reference.n,
        parts=dict(CAUSES),
        trackers=found,
        plan=plan,
    )


def _by_unit(mechanism: Mechanism, errors: np.ndarray, increments: np.ndarray) -> dict[str, Shares]:
    """Return the parts of errors and increments (n_steps, t, n, n_s) [rad or m], for the joints of each unit."""
    names = np.array([joint.name for joint in mechanism.independent_joints])
    return {
        unit: error_parts(factor * errors[..., which], factor * increments[..., which], names[which].tolist())
        for unit, (which, factor) in actuated_by_unit(mechanism).items()
    }
