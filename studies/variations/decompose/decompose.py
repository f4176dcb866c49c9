"""The study behind `linkplan decompose`: the causes of each tracker's error on a plan.

A tracking error is a sum of its causes: signed parts that add up to the rms error.
Let e_1 to e_K be the errors after causes 1 to K are switched on, and e = e_K the total error. Let d_k be what cause k
adds, so that d_1 + ... + d_K = e: e_k - e_{k-1}, or its mean over several orders of the causes. Let <a, b> be the mean over
control instants and machines of the sum over joints of a b. The part of cause k is the projection of its increment on the
total error:

    p_k = <d_k, e> / rms,   rms = sqrt(<e, e>),   so that p_1 + ... + p_K = rms

exactly. A negative part reduces the error. The rms values of the increments, and the differences of rms values, do not add
up to the rms error, because errors of different causes can cancel or occur at different times.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from linkplan.controllers.trackers.names import LINEAR
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.folders import plain_record
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import whole
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.compare import actuated_by_unit
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.variations.decompose.decomposition import Decomposition, Shares, TrackerShares
from linkplan.studies.variations.decompose.ladder import CAUSES, run_ladder
from linkplan.studies.variations.experiment.experiment import Settings, experiment_of, imperfections_asked

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
