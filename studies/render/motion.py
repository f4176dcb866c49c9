"""A tracked motion to draw: simulated poses, planned poses, and efforts."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.phases.ground_plant import on_ground
from linkplan.controllers.reference import SampledReference
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.plan import Plan
from linkplan.planner.search.planning import silent
from linkplan.studies.compare.compare import track, tracking_reference
from linkplan.studies.compare.ground_tracking import ground_tracking
from linkplan.studies.render.efforts import load_shares

MAX_FILM_FRAMES = 20_000


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class TrackedMotion:
    """A run at its control instants (n,) [s]: poses and planned poses (n, n_q), efforts (n, n_u) and their limits (n_u, 2).

    `shares` (n, n_u) are the efforts as shares of their limits. `repeats` is True for a periodic motion, `passed` if the
    plan passes its certificate.
    """

    mechanism: Mechanism
    name: str
    tracker: str
    time_s: np.ndarray
    pose: np.ndarray
    reference: np.ndarray
    effort: np.ndarray
    limit: np.ndarray
    shares: np.ndarray
    stable: bool
    repeats: bool
    passed: bool

    @property
    def duration_s(self) -> float:
        """The duration [s], to the end of the last control period."""
        return float(self.time_s[-1] + (self.time_s[1] - self.time_s[0]))

    def index_at(self, time_s: float) -> int:
        """Return the index of the control period at a time [s]; the last one after the end."""
        return int(np.clip(np.searchsorted(self.time_s, time_s + 1e-9, side="right") - 1, 0, len(self.time_s) - 1))


def tracked_motion(plan: Plan, tracker: str, reference: SampledReference | None = None) -> TrackedMotion:
    """Return a plan's motion tracked in MuJoCo; `reference` is the plan's reference, if it is already computed.

    Raises:
        ProblemError: if the run diverges in the first step.
    """
    reference = tracking_reference(plan) if reference is None else reference
    run = track(plan, tracker, None, reference)
    kept = int(np.sum(np.cumprod(np.isfinite(run.pose_rad).all(axis=1))))
    if kept < 2:
        raise ProblemError(f"the run with {tracker} diverges in the first step: there is no motion to draw")
    effort, limit = run.applied[:kept], np.array(run.effort_limit)
    return TrackedMotion(
        mechanism=plan.problem.mechanism,
        name=plan.problem.name,
        tracker=tracker,
        time_s=run.time_s[:kept],
        pose=run.pose_rad[:kept],
        reference=reference.pose_rad[:kept],
        effort=effort,
        limit=limit,
        shares=load_shares(effort, limit, np.abs(effort).max(axis=0, initial=0.0)),
        stable=run.stable,
        repeats=bool(plan.trajectory.periodic),
        passed=plan.passed,
    )


def motion_on_ground(record: PhasedRecord, tracker: str) -> TrackedMotion:
    """Return a motion in phases as tracked on the ground, which is drawn.

    Raises:
        LinkplanError: as for tracking.
    """
    tracked = ground_tracking(record, [tracker], None, silent, alone=True)
    ground, (run,), (log,) = tracked.motion, tracked.runs.values(), tracked.logs.values()
    mechanism, limit = ground.mechanism, effort_bounds(record.plans[0].problem)
    drawn = replace(mechanism, model=on_ground(mechanism, ground.feet, float(mechanism.model.opt.timestep)))
    return TrackedMotion(
        mechanism=drawn,
        name=record.problem,
        tracker=tracker,
        time_s=log.time_s,
        pose=log.pose,
        reference=ground.whole.pose_rad[: len(log.pose)],
        effort=log.effort,
        limit=limit,
        shares=load_shares(log.effort, limit, np.abs(log.effort).max(axis=0, initial=0.0)),
        stable=run.passed,
        repeats=False,
        passed=record.passed,
    )


def own_slowness(duration_s: float) -> float:
    """Return the default slowness of a motion, one of 1, 2, 5, 10, ..., so that a film lasts about 4 s."""
    wanted = max(1.0, 4.0 / duration_s)
    ten = 10.0 ** np.floor(np.log10(wanted))
    return float(min((step * ten for step in (1.0, 2.0, 5.0, 10.0)), key=lambda step: abs(np.log(step / wanted))))


def frame_times(duration_s: float, slow: float, fps: float, *, repeats: bool = False) -> np.ndarray:
    """Return the times (n,) [s] of a film's frames, from 0 to the end; without the end for a periodic motion.

    Raises:
        ProblemError: if there are more than `MAX_FILM_FRAMES`.
    """
    step = 1.0 / (fps * slow)
    many = duration_s / step
    if many > MAX_FILM_FRAMES:
        raise ProblemError(
            f"a motion of {duration_s:.4g} s, {slow:g} times slower at {fps:g} frames per second, has {many:.0f} frames;"
            f" the limit is {MAX_FILM_FRAMES}"
        )
    if repeats:
        n = max(1, round(many))
        return duration_s * np.arange(n) / n
    times = step * np.arange(int(np.floor(many + 1e-6)) + 1)
    return times if duration_s - times[-1] < 0.5 * step else np.append(times, duration_s)
