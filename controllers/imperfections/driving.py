"""The drives of many simulations at once: from commands to applied efforts. Written for speed.

During a simulator step the applied effort is its mean over the step, so that a delay, lag or push that ends within a step
keeps its impulse. Every row is computed independently of the others, to the last bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.imperfections.imperfections import Drives, stacked


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class DriveState:
    """The drives of n simulations. Arrays are (n, n_u), except `whole`, `late`, `fraction` (n,) and `low`, `high` (n_u,).

    `queue` (n, p, n_u) holds the last p = `n_queued` commands; slot k mod p holds the command of instant k. A command acts
    after `whole` periods, `late` simulator steps and a `fraction` of a step. `left` is the share of an initial difference
    that a lag leaves after a step, `mean` its mean share over the step, `most` the largest change in a step and `output`
    the lagged effort. `line` (n_u, 2) are the stall efforts and no-load speeds of motors, or None. `punctual`: all commands
    act at the beginning of a period. `together`: the common whole delay, or None if delays differ. `take` and `act` change
    `queue` and `output` only.
    """

    low: np.ndarray
    high: np.ndarray
    line: np.ndarray | None
    resolution: np.ndarray
    factor: np.ndarray
    whole: np.ndarray
    late: np.ndarray
    fraction: np.ndarray
    left: np.ndarray
    mean: np.ndarray
    most: np.ndarray
    punctual: bool
    together: int | None
    lagged: bool
    scaled: bool
    rounded: bool
    n_queued: int
    queue: np.ndarray
    output: np.ndarray

    @property
    def clamp(self) -> np.ndarray:
        """The effort limits (n, n_u, 2) [N.m or N]: the current limits times each machine's torque constant factor."""
        return np.maximum(1.0, self.factor)[:, :, None] * np.stack([self.low, self.high], axis=1)


def driving(
    drives: Sequence[Drives],
    delays: Sequence[float],
    timesteps_s: Sequence[float] | np.ndarray,
    substeps: int,
    limit: np.ndarray,
    held: np.ndarray | None = None,
    *,
    line: np.ndarray | None = None,
    slowest: np.ndarray | None = None,
) -> DriveState:
    """Return the drives of machines (n,).

    Args:
        drives: of each machine.
        delays: of each [control periods].
        timesteps_s: of each.
        substeps: simulator steps per period.
        limit: (n_u, 2) [N.m or N].
        held: (n_u,) efforts before the first command, at which lags and rate limits begin; zero by default.
        line: (n_u, 2) stall efforts and no-load speeds, infinite without a torque-speed line.
        slowest: (n_u,) rates that no drive exceeds, besides its own [per second].
    """
    n_u = len(limit)
    held = np.zeros(n_u) if held is None else np.clip(held, limit[:, 0], limit[:, 1])

    def of_all(name: str) -> np.ndarray:
        return stacked([getattr(one, name) for one in drives], n_u)

    steps = np.array([round(delay * substeps, 9) for delay in delays])  # a delay of n / substeps is a whole step
    whole = np.floor(steps / substeps).astype(int)
    late = np.floor(steps - substeps * whole).astype(int)
    fraction = steps - substeps * whole - late
    bandwidth, rate = of_all("bandwidth_hz"), np.minimum(of_all("rate_limit"), np.inf if slowest is None else slowest)
    each = zip(bandwidth, timesteps_s, strict=True)
    phases = np.array([[2 * np.pi * f * h for f in row] for row, h in each]).reshape(len(drives), n_u)
    left = np.array([[float(np.exp(-x)) for x in row] for row in phases]).reshape(phases.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(np.isinf(phases), 0.0, (1.0 - left) / phases)
    resolution, factor = of_all("resolution"), of_all("constant_factor")
    n_queued = int(whole.max(initial=0)) + 2
    return DriveState(
        low=np.array(limit[:, 0], dtype=float),
        high=np.array(limit[:, 1], dtype=float),
        line=line if line is not None and np.isfinite(line).any() else None,
        resolution=resolution,
        factor=factor,
        whole=whole,
        late=late,
        fraction=fraction,
        left=left,
        mean=mean,
        most=rate * np.array(timesteps_s)[:, None],
        punctual=not (np.any(late) or np.any(fraction)),
        together=int(whole[0]) if np.ptp(whole) == 0 else None,
        lagged=bool(np.any(np.isfinite(bandwidth)) or np.any(np.isfinite(rate))),
        scaled=bool(np.any(factor != 1.0)),
        rounded=bool(np.any(resolution > 0)),
        n_queued=n_queued,
        queue=np.zeros((len(drives), n_queued, n_u)),
        output=np.tile(held, (len(drives), 1)),
    )


def stretches(drives: DriveState, substeps: int) -> list[tuple[int, int]]:
    """Return the runs of simulator steps with constant efforts in a period: (first step, number of steps).

    The first step of a period is a run of its own, because the log records values at its beginning.
    """
    if drives.lagged or drives.line is not None or np.any(drives.fraction):
        return [(j, 1) for j in range(substeps)]
    begins = sorted({0, 1, *drives.late.tolist()} - {substeps})
    return [(j, after - j) for j, after in zip(begins, [*begins[1:], substeps], strict=True)]


def take(drives: DriveState, k: int, command: np.ndarray) -> None:
    """Queue the commands (n, n_u) of instant k, rounded and clipped to the limits."""
    if drives.rounded:
        step = np.where(drives.resolution > 0, drives.resolution, 1.0)
        command = np.where(drives.resolution > 0, step * np.round(command / step), command)
    slot = drives.queue[:, k % drives.n_queued]
    np.maximum(command, drives.low, out=slot)
    np.minimum(slot, drives.high, out=slot)
    if k == 0:
        # Before the first command arrives, its value already acts, as if the loop had been running before.
        drives.queue[:] = slot[:, None].copy()


def act(drives: DriveState, k: int, j: int, speed: np.ndarray | None = None) -> np.ndarray:
    """Return the mean efforts (n, n_u) over simulator step j of period k; `speed` (n, n_u) [rad/s or m/s] is for lines."""
    effort = arrived(drives, k)
    if not drives.punctual:
        before = arrived(drives, k - 1)
        share = np.minimum(np.maximum(drives.late + drives.fraction - j, 0.0), 1.0)[:, None]  # of the previous command
        effort = share * before + (1.0 - share) * effort
    if drives.lagged:
        start = drives.output
        settled = effort + (start - effort) * drives.left
        end = np.minimum(np.maximum(settled, start - drives.most), start + drives.most)
        mean = effort + (start - effort) * drives.mean
        effort = np.where(end == settled, mean, 0.5 * (start + end))
        drives.output[:] = end
    if drives.line is not None and speed is not None:
        stall, share = drives.line[:, 0], speed / drives.line[:, 1]
        effort = np.minimum(np.maximum(effort, -stall * (1.0 + share)), stall * (1.0 - share))
    return effort * drives.factor if drives.scaled else effort


def arrived(drives: DriveState, k: int) -> np.ndarray:
    """Return the commands (n, n_u) that have arrived by period k."""
    p = drives.n_queued
    if drives.together is not None:
        return drives.queue[:, (k - drives.together) % p]
    return drives.queue[np.arange(len(drives.queue)), (k - drives.whole) % p]
