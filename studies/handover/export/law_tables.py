"""A plan's control law as tables: rows of reference, feedforward and gains over time, interpolated between the rows.

Every law here is u = u_ff(t) + K(t) (x_ref(t) - x) with x = (s, v): PD and PD with feedforward, gain-scheduled PD, LQR.
There is a row at every control instant, at which the law equals the tracker. Additional rows hold the start before the
motion and the goal after it. A periodic motion has the rows of one period.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.reference import SampledReference, hermite, sample
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import is_redundant, needed_effort, sampled
from linkplan.models.poses.assembly import follow
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.limits import Limits
from linkplan.studies.compare.compare import build_tracker, lqr_settings, tracking_reference
from linkplan.studies.feedback.frequency.floquet import linear_law
from linkplan.studies.handover.export.c_text import identifier

# Larger tables rarely fit into a controller's flash; the file would have 100 megabytes of text.
_MAX_NUMBERS = 4_000_000
# A time this close to a row, as a share of the control period, counts as the row's time (rounding in single precision).
ROW_SHARE = 1e-3


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class LawTables:
    """A linear law in rows at times `time_s` (n,) [s], the first 0 and the last the duration.

    `position` and `velocity` (n + 2, n_s), `feedforward` (n + 2, n_u) and `gains` (n + 2 or 1, n_u, 2 n_s) have a row of the
    held start before the others and one of the held goal after them; one gain stands for all rows if it is constant. A
    `periodic` motion has no held rows (n, ...), repeats, and moves on by `advance` (n_s,) [rad] in each period. `maps`
    (n + 2, n_u, n_s), the transposes of Gamma^T B, are for actuators that share efforts, or None.
    """

    prefix: str
    tracker: str
    mechanism: Mechanism
    limits: Limits
    plan_hash: str
    period_s: float
    periodic: bool
    advance: np.ndarray
    time_s: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    feedforward: np.ndarray
    gains: np.ndarray
    maps: np.ndarray | None

    @property
    def held(self) -> int:
        """The number of held rows before the first instant."""
        return 0 if self.periodic else 1

    def effort(self, time_s: float, position_rad: np.ndarray, velocity_rad_s: np.ndarray) -> np.ndarray:
        """Return the efforts (n_u,) [N.m or N] of the law at a time [s], before, during or after the motion."""
        within, periods = time_s, 0.0
        if self.periodic:
            periods = np.floor(time_s / self.time_s[-1])
            within = time_s - periods * self.time_s[-1]
        near = ROW_SHARE * self.period_s
        if not self.periodic and not -near <= within <= self.time_s[-1] + near:
            below, share, step = (0 if within < 0 else len(self.position) - 1), 0.0, 1.0
        else:
            k = int(np.clip(np.searchsorted(self.time_s, within, side="right") - 1, 0, len(self.time_s) - 2))
            step = float(self.time_s[k + 1] - self.time_s[k])
            if self.time_s[k + 1] - within < near:
                k, share = k + 1, 0.0
            else:
                share = 0.0 if within - self.time_s[k] < near else float(within - self.time_s[k]) / step
            below = self.held + k
        above = below + (share > 0)
        state = interpolated_state(self, np.array([below]), np.array([above]), np.array([share]), step)[0]
        error = state - np.concatenate([position_rad, velocity_rad_s])
        error[: len(self.advance)] += periods * self.advance
        ends = [0, 0] if len(self.gains) == 1 else [below, above]
        gain = (1 - share) * self.gains[ends[0]] + share * self.gains[ends[1]]
        return (1 - share) * self.feedforward[below] + share * self.feedforward[above] + gain @ error


def interpolated_state(
    tables: LawTables, below: np.ndarray, above: np.ndarray, share: np.ndarray, step: float
) -> np.ndarray:
    """Return the reference states (n, 2 n_s) at shares (n,) of a step [s] between rows, by cubic Hermite interpolation."""
    ends = [(tables.position[row], step * tables.velocity[row]) for row in (below, above)]
    position, slope = hermite(*ends[0], *ends[1], share[:, None])
    return np.hstack([position, slope / step])


def law_tables(plan: Plan, tracker: str, tolerance: float = 0.0) -> LawTables:
    """Return the tables of a built-in tracker on a plan.

    Args:
        plan: with a motion.
        tracker: one of `formats.C_TRACKERS`.
        tolerance: rows are omitted as long as the reference's efforts and the gains change at no control instant by more
            than this share of their largest values; 0 keeps a row at every control instant.

    Raises:
        ProblemError: for an invalid tolerance, or tables that would be too large.
    """
    if not 0 <= tolerance < 1:
        raise ProblemError(f"tolerance must be a share from 0 to below 1, got {tolerance:g}")
    mechanism, trajectory, plan = plan.problem.mechanism, plan.require_motion("export"), _over_the_motion(plan)
    run = tracking_reference(plan)
    law = linear_law(build_tracker(tracker, plan, run))
    rows, times = _rows(mechanism, plan, run)
    gains = law.gains[: len(times)]
    if trajectory.periodic:
        gains = np.concatenate([gains, gains[:1]])
    else:
        at_goal = linear_law(build_tracker(tracker, plan, rows.part(slice(-1, None)))).gains
        gains = np.concatenate([gains[:1], gains, np.repeat(at_goal, len(times) + 1 - len(gains), axis=0)])
    if np.all(gains == gains[0]):
        gains = gains[:1]
    tables = LawTables(
        prefix=identifier(plan.problem.name) + "_law",
        tracker=tracker,
        mechanism=mechanism,
        limits=plan.problem.limits,
        plan_hash=_plan_hash(plan),
        period_s=run.period_s,
        periodic=trajectory.periodic,
        advance=trajectory.advance,
        time_s=times,
        position=rows.position_rad,
        velocity=rows.velocity_rad_s,
        feedforward=rows.effort if law.feedforward else np.zeros_like(rows.effort),
        gains=gains,
        maps=sampled(mechanism.dynamics.effort_map, rows.pose_rad).transpose(0, 2, 1) if is_redundant(mechanism) else None,
    )
    tables = _thinned(tables, tolerance, np.abs(rows.effort).max(axis=0)) if tolerance > 0 else tables
    numbers = sum(x.size for x in arrays_of(tables).values())
    if numbers > _MAX_NUMBERS:
        raise ProblemError(
            f"the tables of {len(times)} control instants have {numbers} numbers, more than {_MAX_NUMBERS}; set a longer"
            " tracking.period_s, or a tolerance"
        )
    return tables


def arrays_of(tables: LawTables) -> Mapping[str, np.ndarray]:
    """Return the tables by name, gains and maps row by row."""
    maps = {} if tables.maps is None else {"maps": tables.maps.reshape(len(tables.maps), -1)}
    return maps | {
        "time": tables.time_s,
        "position": tables.position,
        "velocity": tables.velocity,
        "feedforward": tables.feedforward,
        "gains": tables.gains.reshape(len(tables.gains), -1),
    }


def _over_the_motion(plan: Plan) -> Plan:
    """Return the plan with a run over the whole motion; its control period divides the period of a cyclic motion.

    The LQR's errors of unit cost are those of the plan's original run.
    """
    run, trajectory = tracking_reference(plan), plan.require_motion("export")
    settings, duration = lqr_settings(plan, run), trajectory.duration_s
    if trajectory.periodic:
        period = settings.period_s if run.cycle is not None else duration / round(duration / settings.period_s)
        settings = settings.replace(period_s=period, duration_s=duration)
    elif settings.duration_s is not None and settings.duration_s < duration:
        settings = settings.replace(duration_s=duration)
    return replace(plan, problem=plan.problem.varied(tracking=settings))


def _rows(mechanism: Mechanism, plan: Plan, run: SampledReference) -> tuple[SampledReference, np.ndarray]:
    """Return the reference at all rows, and the rows' times (n,) [s]: control instants, and the motion's end.

    Unless the motion is periodic, the reference has an additional held row at each end.
    """
    trajectory = plan.require_motion("export")
    whole = int(np.floor(trajectory.duration_s / run.period_s + ROW_SHARE))
    limit = plan.problem.limits.actuators_effort
    moving = sample(mechanism, trajectory, run.period_s, (whole + 1) * run.period_s, limit)
    if trajectory.periodic:  # its last row equals the first one, a period later
        return moving, np.append(moving.time_s[:-1], trajectory.duration_s)
    ends = trajectory.position_at(trajectory.breaks_s[[0, -1]])
    poses = np.array([trajectory.start_pose, follow(mechanism, ends[1:], moving.pose_rad[-1])[0]])
    rest = np.zeros_like(ends)
    own = trajectory.effort_at(trajectory.breaks_s[[0, -1]])
    effort, _ = needed_effort(mechanism, poses, rest, rest, trajectory.breaks_s[[0, -1]], limit=limit, wanted=own)
    held = {"pose_rad": poses, "position_rad": ends, "velocity_rad_s": rest, "effort": effort}
    last = dict(held)
    times = moving.time_s
    inside = trajectory.duration_s - times[-1] > ROW_SHARE * run.period_s
    if inside:  # the motion ends between two control instants
        last["velocity_rad_s"] = trajectory.velocity_at(trajectory.breaks_s[[-1, -1]])
        times = np.append(times, trajectory.duration_s)
    rows = {
        name: np.concatenate([held[name][:1], getattr(moving, name), *([last[name][1:]] if inside else []), held[name][1:]])
        for name in held
    }
    time = np.concatenate([[-run.period_s], times, [times[-1] + run.period_s]])
    forces = mechanism.forces_at(np.clip(time, 0.0, trajectory.duration_s))
    return SampledReference(period_s=run.period_s, time_s=time, cycle=None, forces=forces, **rows), times


def _thinned(tables: LawTables, tolerance: float, size: np.ndarray) -> LawTables:
    """Return tables with the fewest rows that a greedy search finds within a tolerance of the largest efforts (n_u,)."""
    kept = [0]
    while kept[-1] < len(tables.time_s) - 1:
        begin, step = kept[-1], 1
        while begin + 2 * step < len(tables.time_s) and _fits(tables, begin, begin + 2 * step, tolerance, size):
            step *= 2
        far = min(begin + 2 * step, len(tables.time_s))
        near = begin + step
        while far - near > 1:
            middle = (near + far) // 2
            near, far = (middle, far) if _fits(tables, begin, middle, tolerance, size) else (near, middle)
        kept.append(near)
    rows = np.array(kept) + tables.held
    rows = rows if tables.periodic else np.concatenate([[0], rows, [len(tables.position) - 1]])
    return replace(
        tables,
        time_s=tables.time_s[kept],
        position=tables.position[rows],
        velocity=tables.velocity[rows],
        feedforward=tables.feedforward[rows],
        gains=tables.gains if len(tables.gains) == 1 else tables.gains[rows],
        maps=None if tables.maps is None else tables.maps[rows],
    )


def _fits(tables: LawTables, begin: int, end: int, tolerance: float, size: np.ndarray) -> bool:
    """Return True if the rows between two others may be omitted."""
    inner = np.arange(begin + 1, end)
    step = float(tables.time_s[end] - tables.time_s[begin])
    share = (tables.time_s[inner] - tables.time_s[begin]) / step
    below, above, rows = (at + tables.held for at in (np.full_like(inner, begin), np.full_like(inner, end), inner))
    state = interpolated_state(tables, below, above, share, step)
    error = state - np.hstack([tables.position[rows], tables.velocity[rows]])
    constant = len(tables.gains) == 1
    x = share[:, None]
    effort = (1 - x) * tables.feedforward[below] + x * tables.feedforward[above] - tables.feedforward[rows]
    gains = tables.gains[np.zeros_like(rows)] if constant else tables.gains[rows]
    effort = effort + np.einsum("nux,nx->nu", gains, error)
    if np.any(np.abs(effort) > tolerance * size):
        return False
    if constant:
        return True
    between = (1 - x[..., None]) * tables.gains[below] + x[..., None] * tables.gains[above]
    return bool(np.all(np.abs(between - gains) <= tolerance * np.abs(tables.gains).max(axis=0)))


def _plan_hash(plan: Plan) -> str:
    """Return a hash of a plan's mechanism and motion."""
    trajectory, digest = plan.require_motion("export"), hashlib.sha256(plan.problem.mechanism.fingerprint().encode())
    for name in ("breaks_s", "position", "velocity", "effort", "start_pose"):
        digest.update(getattr(trajectory, name).tobytes())
    return digest.hexdigest()
