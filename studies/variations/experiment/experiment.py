"""The definition of an experiment: trackers, machines and the criterion of success; its default imperfections.

The default imperfections, for a problem file without any, are those of a carefully built machine: a driven joint with an
absolute encoder of 19 bits, a current loop of some hundred hertz and a controller with about one period of delay.
docs/experiments.md has the table.
"""

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from msgspec import Struct

from linkplan.controllers.imperfections.imperfections import Imperfections, imperfections_from
from linkplan.controllers.imperfections.plant import plant
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import is_payload_s_weight
from linkplan.planner.files.folders import plain_record
from linkplan.planner.plan.folder import versions
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.imperfections import Factor, ImperfectionFactors, Spread, drawn_parameters, imperfections_of
from linkplan.planner.problem.settings import number, whole
from linkplan.studies.compare.compare import control_loop, tracking_reference
from linkplan.studies.compare.user_tracker import TrackerLike, known_tracker

LATIN_HYPERCUBE = "latin-hypercube"
DESIGNS = (LATIN_HYPERCUBE, "grid")
# Half width of a normal distribution's central 95 % interval, in standard deviations.
_NORMAL_QUANTILE = 1.959963984540054
# Independent Latin hypercubes of an experiment: their means give the confidence intervals.
N_HYPERCUBES = 10
# Most samples of an experiment: more are probably a typing error.
MOST_SAMPLES = 1_000_000


def machines_by_design(factors: Sequence[Factor], design: str, samples: int, levels: int, seed: int) -> np.ndarray:
    """Return the factors' values (n, d) in a problem file's units.

    Fixed factors are the same in every sample. In a Latin hypercube, each factor's range is divided into intervals of equal
    probability, and each interval has one sample (McKay, Beckman and Conover, Technometrics 21, 1979). The samples are
    `N_HYPERCUBES` independent hypercubes, whose means give the uncertainty of the overall mean (Iman & Conover,
    Communications in Statistics A 9, 1980). A grid has `levels` values of each factor, evenly spaced over its range, for a
    normal distribution over its central 95 %.

    Raises:
        ProblemError: for a grid of more than `MOST_SAMPLES`.
    """
    random = varied(factors)
    shares = _grid(len(random), levels) if design == "grid" else _hypercubes(len(random), samples, seed)
    values = np.tile([factor.spread.first for factor in factors], (len(shares), 1)).reshape(len(shares), len(factors))
    for column, i in enumerate(random):
        quantity, share = factors[i].quantity, shares[:, column]
        low, high = ends_of(factors[i])
        value = at_chance(factors[i].spread, share) if design == LATIN_HYPERCUBE else low + share * (high - low)
        values[:, i] = np.clip(value, quantity.low, quantity.high)
    return values


def _grid(count: int, levels: int) -> np.ndarray:
    """Return the shares (n, count) of ranges at the nodes of a grid."""
    size = levels**count
    if size > MOST_SAMPLES:
        raise ProblemError(
            f"a grid of {levels} levels in {count} factors has {size:.3g} samples, at most {MOST_SAMPLES}; a"
            " Latin hypercube takes any number"
        )
    even = np.linspace(0.0, 1.0, levels) if levels > 1 else np.full(1, 0.5)
    return np.array(list(itertools.product(even, repeat=count))).reshape(size, count)


def _hypercubes(count: int, samples: int, seed: int) -> np.ndarray:
    """Return the probabilities (samples, count) of independent Latin hypercubes."""
    from scipy.stats import qmc

    if count == 0:
        return np.zeros((samples, 0))
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    sizes = np.bincount(replicate_of(samples))
    return np.vstack([qmc.LatinHypercube(count, rng=rng).random(int(size)) for size in sizes])


def replicate_of(samples: int) -> np.ndarray:
    """Return the number (n,) of the Latin hypercube that each sample belongs to: `N_HYPERCUBES` in turn, of equal size."""
    count = min(N_HYPERCUBES, samples)
    return np.arange(samples) * count // samples


def varied(factors: Sequence[Factor]) -> list[int]:
    """Return the indices of the factors that differ between machines."""
    return [i for i, factor in enumerate(factors) if factor.spread.random]


def ends_of(factor: Factor) -> tuple[float, float]:
    """Return the ends of a factor's range; for a normal distribution, of its central 95 % interval."""
    spread = factor.spread
    if spread.kind == "normal":
        ends = spread.first - _NORMAL_QUANTILE * spread.second, spread.first + _NORMAL_QUANTILE * spread.second
        return max(ends[0], factor.quantity.low), min(ends[1], factor.quantity.high)
    return spread.first, spread.second


def at_chance(spread: Spread, chance: np.ndarray) -> np.ndarray:
    """Return the quantiles of a distribution at probabilities between 0 and 1."""
    from scipy.stats import norm

    if spread.kind == "uniform":
        return spread.first + chance * (spread.second - spread.first)
    return spread.first + spread.second * norm.ppf(chance)


def default_imperfections(plan: Plan) -> dict:
    """Return the table [imperfections] of a carefully built machine for the plan's mechanism."""
    mechanism = plan.problem.mechanism
    limit = np.abs(plan.problem.limits.actuators_effort).max(axis=1)
    peak = np.asarray(plan.certificate.peak_effort, dtype=float)
    size = np.where(np.isfinite(limit), limit, np.maximum(peak, 1e-9))
    table: dict = {
        "period_factor": {"normal": [1.0, 1e-4]},
        "delay_periods": [0.5, 1.5],
        "velocity_filter_hz": 1000.0,
        "torque_bandwidth_hz": [500.0, 1500.0],
        "torque_constant_factor": {"normal": [1.0, 0.03]},
        "payload_mass_factor": [0.9, 1.1],
        "link_length_factor": {"normal": [1.0, 2e-4]},
    }
    if any(is_payload_s_weight(name) for name in drawn_parameters(mechanism)):
        del table["payload_mass_factor"]  # it is known better
    kinds = {joint.kind for joint in mechanism.independent_joints}
    if "hinge" in kinds:
        table |= {
            "encoder_resolution_deg": 360.0 / 2**19,
            "encoder_offset_deg": {"normal": [0.0, 0.02]},
            "start_error_deg": {"normal": [0.0, 0.05]},
        }
    if "slide" in kinds:
        step = mechanism.extent_m / 2**16
        table |= {
            "encoder_resolution_m": step,
            "encoder_offset_m": {"normal": [0.0, 10 * step]},
            "start_error_m": {"normal": [0.0, 20 * step]},
        }
    actuators = list(zip(mechanism.actuators, size.tolist(), strict=True))
    # A 12-bit command of both signs; friction up to 2 % of the effort limit, or of the planned peak without a limit.
    table["torque_resolution"] = {actuator.name: most / 2048 for actuator, most in actuators}
    driven = {mechanism.joints[actuator.joint].name: most for actuator, most in actuators if actuator.joint is not None}
    if driven:
        table["coulomb_friction"] = {joint: [0.0, 0.02 * most] for joint, most in driven.items()}
    return table


class Settings(Struct, frozen=True, kw_only=True):
    """The settings of an experiment: trackers, samples, design, seed, and the tube about the path that defines success.

    The number of samples of a grid follows from its levels.
    """

    trackers: tuple[str, ...] = TRACKERS
    samples: int = 200
    seed: int = 0
    design: str = "latin-hypercube"
    levels: int = 3
    tube_deg: float = 1.0
    tube_m: float = 0.01

    def __post_init__(self) -> None:
        names = tuple(self.trackers)
        if not names or len(set(names)) < len(names):
            raise ProblemError(f"an experiment needs one or more different trackers, got {', '.join(names) or 'none'}")
        for name in names:
            known_tracker(name)
        whole(self.samples, "samples", 1, MOST_SAMPLES)
        whole(self.seed, "seed", 0, 2**63 - 1)
        whole(self.levels, "levels", 1, 1000)
        choose("design", self.design, DESIGNS, ProblemError)
        number(self.tube_deg, "tube_deg", positive=True)
        number(self.tube_m, "tube_m", positive=True)


class AskedRecord(Struct, frozen=True, omit_defaults=True):
    """All inputs of an experiment's results, made by `request_of` and stored in `experiment.json`."""

    format: Literal[1]
    problem: dict[str, Any]
    plan: str | None
    settings: Settings
    versions: dict[str, str]
    tracker_sources: dict[str, str] | None = None


class ExperimentRecord(Struct, frozen=True):
    """The part of `experiment.json` that is read back; the rest follows from the results."""

    asked: AskedRecord


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Experiment:
    """Trackers of one plan on n machines.

    `values` (n, d): values of the section's factors in a problem file's units. `tube` (n_s,) [rad or m]: the tolerance about
    the path. `end_s` [s]: the end of the motion, after which the goal is held; None for a periodic motion. `own`: trackers
    given as Python objects, by their names in the settings.
    """

    plan: Plan
    settings: Settings
    section: ImperfectionFactors
    values: np.ndarray
    reference: SampledReference
    loop: ControlLoop
    tube: np.ndarray
    end_s: float | None
    own: Mapping[str, TrackerLike] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """The number of samples."""
        return len(self.values)

    def varied_values(self) -> dict[str, np.ndarray]:
        """Return the values (n,) of the imperfections that differ between machines, by column name."""
        factors = zip(self.section.factors, self.values.T, strict=True)
        return {f"imperfection.{factor.label}": values for factor, values in factors if np.ptp(values) > 0}

    def machine(self, sample: int) -> Imperfections:
        """Return a sample's machine, which is the same for every tracker and in every experiment with these settings."""
        mechanism, noise = self.plan.problem.mechanism, (self.settings.seed, 1, sample)
        return machine_of(self.section, self.values[sample], mechanism, noise)


def machine_of(
    section: ImperfectionFactors, values: np.ndarray, mechanism: Mechanism, noise_seed: tuple[int, ...]
) -> Imperfections:
    """Return the machine with a value for each of the section's factors, and with the noise of a seed."""
    given: dict[str, dict[str, float]] = {}
    for factor, value in zip(section.factors, values, strict=True):
        given.setdefault(factor.key, {})[factor.name] = float(value)
    return imperfections_from(given, mechanism, noise_seed, section.push_body, section.push_joint)


def experiment_of(plan: Plan, settings: Settings) -> Experiment:
    """Return the experiment of a plan with its own [imperfections], or with the default ones if it has none.

    Raises:
        ProblemError: for invalid imperfections.
        LinkplanError: if the machine with median imperfections cannot be built.
    """
    problem = plan.problem
    mechanism = problem.mechanism
    section = imperfections_of(imperfections_asked(plan), mechanism)
    values = machines_by_design(section.factors, settings.design, settings.samples, settings.levels, settings.seed)
    trajectory, tracking = plan.trajectory, problem.tracking
    ends = not trajectory.periodic
    if tracking.duration_s is None and ends:
        tracking = tracking.replace(duration_s=1.25 * trajectory.duration_s)  # errors settle while the goal is held
    reference = tracking_reference(replace(plan, problem=problem.varied(tracking=tracking)))
    loop = control_loop(problem)
    hinge = np.array([joint.kind == "hinge" for joint in mechanism.independent_joints])
    passive = ~mechanism.actuated  # joints that cannot be controlled
    middle = np.median(values, axis=0)
    plant(mechanism, reference, loop, machine_of(section, middle, mechanism, (0,)), 1)  # raises errors before the run
    end_s = float(reference.time_s[-1])
    pushed = [column for column, factor in enumerate(section.factors) if factor.label == "push_start_s"]
    if pushed and (first := values[:, pushed[0]].min()) >= end_s:
        raise ProblemError(
            f"imperfections.push_start_s must be before the end of the run, {end_s:.4g} s, on at least one machine; got"
            f" {first:g} or more; tracking.duration_s makes runs longer"
        )
    return Experiment(
        plan=plan,
        settings=settings,
        section=section,
        values=values,
        reference=reference,
        loop=loop,
        tube=np.where(passive, np.inf, np.where(hinge, np.radians(settings.tube_deg), settings.tube_m)),
        end_s=trajectory.duration_s if ends else None,
    )


def fall_note(experiment: Experiment) -> str | None:
    """Return a sentence if the goal cannot be held after the motion within the effort limits, else None."""
    end_s, reference = experiment.end_s, experiment.reference
    if end_s is None or reference.time_s[-1] <= end_s:
        return None
    low, high = experiment.loop.effort_limit.T
    needed = reference.effort[-1]
    for actuator, effort, least, most in zip(experiment.plan.problem.mechanism.actuators, needed, low, high, strict=True):
        if not least <= effort <= most:
            unit, limit = actuator.unit, abs(least if effort < least else most)
            return (
                f"holding the goal from {end_s:.4g} s on needs {abs(effort):.3g} {unit} of {actuator.name}, limit"
                f" {limit:.3g}: the mechanism falls then with any tracker; tracking.duration_s = {end_s:.4g} ends the run"
                " before"
            )
    return None


def imperfections_asked(plan: Plan) -> dict:
    """Return the table [imperfections] of a plan's problem, an empty one for none; without a table, the default ones."""
    section = plan.problem.sections.imperfections
    return default_imperfections(plan) if section is None else section.to_dict()


def defaults_note(plan: Plan) -> str | None:
    """Return the note on a missing or an empty [imperfections] table, or None if the table has imperfections."""
    section = plan.problem.sections.imperfections
    if section is None:
        names = ", ".join([*default_imperfections(plan), *drawn_parameters(plan.problem.mechanism)])
        return f"without [imperfections], those of a carefully built machine are used: {names}"
    return (
        None
        if section.to_dict() or drawn_parameters(plan.problem.mechanism)
        else "[imperfections] is empty: all machines are equal, so shares and intervals have no meaning"
    )


def request_of(source: Mapping, digest: str | None, settings: Settings, trackers: Mapping[str, str]) -> AskedRecord:
    """Return all inputs of an experiment's results: the problem's tables, a saved plan's digest, settings and versions.

    `trackers` are the hashes of the source files of users' trackers.
    """
    return AskedRecord(
        format=1,
        problem=plain_record(source),
        plan=digest,
        settings=settings,
        versions=versions(),
        tracker_sources=dict(trackers) or None,
    )


def plan_digest(plan: Plan) -> str:
    """Return the hash of a plan's motion."""
    trajectory = plan.trajectory
    arrays: Sequence[np.ndarray] = (trajectory.breaks_s, trajectory.position, trajectory.velocity, trajectory.effort)
    digest = hashlib.sha256()
    for array in (*arrays, trajectory.start_pose):
        digest.update(np.ascontiguousarray(array).tobytes() + b"|")
    return digest.hexdigest()
