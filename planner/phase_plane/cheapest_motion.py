"""Motions of least squared effort in a given time, for one degree of freedom, by dynamic programming over a state grid.

With the reduced inertia M, x = integral of sqrt(M) ds and y = dx/dt, the dynamics are y' = (F + D v - R sign v) / sqrt(M):
with force F, drag D and dry friction R of a `PhasePlane`. The least cost from a state is the minimum over the steps of the
cost of a step plus the least cost from the state after it (Bellman, Dynamic Programming, Princeton 1957). The dynamics do
not depend on time, so the same matrix interpolates after every step. On a coarse grid the motion is not an optimum, but it
has the swings of a motion near the global optimum.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.closed_chain.guess import Guess, guess_along
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.phase_plane.bang_bang_motions import Part, parts_of
from linkplan.planner.phase_plane.grid import PhasePlane, grid_of, plane_of
from linkplan.planner.problem.problem import Problem


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Steps:
    """Steps of `step_s` [s] on a plane. A push of 0 is full effort backward, and a push of 1 is full effort forward."""

    plane: PhasePlane
    x: np.ndarray  # (n,) at the plane's positions
    scale: np.ndarray  # (n_u,) the largest efforts
    step_s: float

    def at(self, values: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return values (n,) given at the plane's positions, interpolated to other positions."""
        return np.interp(x, self.x, values)

    def between(self, values: dict[int, np.ndarray], x: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Return the value between those (n,) of both full efforts, interpolated by the push."""
        return (1 - push) * self.at(values[-1], x) + push * self.at(values[+1], x)

    def effort(self, x: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Return the efforts (..., n_u) relative to the largest effort."""
        ends = {way: u[::2] / self.scale for way, u in self.plane.effort.items()}
        one = [self.between({way: u[:, j] for way, u in ends.items()}, x, push) for j in range(len(self.scale))]
        return np.stack(one, axis=-1)

    def after(self, x: np.ndarray, y: np.ndarray, push: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state after a step by the midpoint rule."""
        root = np.sqrt(self.plane.inertia)
        force = {way: f / root for way, f in self.plane.force.items()}
        drag, rub = self.plane.drag / self.plane.inertia, self.plane.rub / root

        def rate(x: np.ndarray, y: np.ndarray) -> np.ndarray:
            return self.between(force, x, push) + self.at(drag, x) * y - self.at(rub, x) * np.sign(y)

        middle = y + 0.5 * self.step_s * rate(x, y)
        return x + self.step_s * middle, y + self.step_s * rate(x + 0.5 * self.step_s * y, middle)

    def cost(self, x: np.ndarray, push: np.ndarray) -> np.ndarray:
        """Return the cost of a step: its squared efforts, relative to the largest effort."""
        return self.step_s * np.square(self.effort(x, push)).sum(axis=-1)


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _States:
    """A grid of states with evenly spaced x (n_x,) and y (n_y,)."""

    x: np.ndarray
    y: np.ndarray

    def corners(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return indices (n, 4) and weights (n, 4) of the grid states around other states (n,), and which are outside."""
        across = (x - self.x[0]) / (self.x[1] - self.x[0]), (y - self.y[0]) / (self.y[1] - self.y[0])
        sizes = len(self.x), len(self.y)
        outside = np.any([(a < 0) | (a > n - 1) for a, n in zip(across, sizes, strict=True)], axis=0)
        i, j = (np.clip(a.astype(int), 0, n - 2) for a, n in zip(across, sizes, strict=True))
        a, b = np.clip(across[0] - i, 0, 1), np.clip(across[1] - j, 0, 1)
        first = i * len(self.y) + j
        index = np.stack([first, first + 1, first + len(self.y), first + len(self.y) + 1], axis=-1)
        return index, np.stack([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b), a * b], axis=-1), outside


def cheapest_guess(problem: Problem, start_pose: np.ndarray, quickest: Guess) -> Guess | None:
    """Return a motion of approximately least squared effort in the given duration; None if there is no grid for it.

    Args:
        problem: a reach of fixed duration between two positions, with limits on all efforts.
        start_pose: the closed pose at the start.
        quickest: the motion of `least_time_guess`; the result stays near the positions of this motion.
    """
    (part,), duration = parts_of(problem.motion), problem.motion.duration_s
    assert duration is not None  # fixed
    grid = grid_of(problem, part.places, start_pose, 800, graded=False)
    if grid is None:
        return None
    plane = plane_of(problem, *grid)
    # The more steps, the more the interpolation after each of them costs.
    root, n_steps = np.sqrt(plane.inertia), 40
    x = np.concatenate([[0.0], np.cumsum(0.5 * plane.cells * (root[1:] + root[:-1]))])
    steps = _Steps(plane=plane, x=x, scale=np.abs(effort_bounds(problem)).max(axis=1), step_s=duration / n_steps)
    times = np.linspace(0.0, quickest.duration_s, 801)
    s, v = quickest.position(times)[:, 0], quickest.velocity(times)[:, 0]
    passed, fast = np.interp(s, plane.s, x), 1.15 * np.abs(np.interp(s, plane.s, root) * v).max()
    room = 0.25 * np.ptp(passed)
    axis = np.linspace(max(x[0], passed.min() - room), min(x[-1], passed.max() + room), 161)
    states = _States(x=axis, y=np.linspace(-fast, fast, 121))
    at_ends = [
        (np.interp(p, plane.s, x), w * np.interp(p, plane.s, root)) for p, w in zip(part.places, part.speeds, strict=True)
    ]
    start, goal = np.array(at_ends)
    path = _followed(steps, states, _least_costs(steps, states, goal, n_steps), start)
    share = np.linspace(0.0, 1.0, n_steps + 1)
    path[:, 0] += (goal[0] - path[-1, 0]) * share**2 * (3 - 2 * share)  # the goal is missed by a cell or so
    return _guess(part, duration, np.interp(path[:, 0], x, plane.s), path[:, 1] / np.interp(path[:, 0], x, root), start_pose)


def _least_costs(steps: _Steps, states: _States, goal: np.ndarray, n_steps: int) -> list[np.ndarray]:
    """Return the least costs (n_x n_y,) with 0, 1, ... steps to go. The final cost grows with the distance to the goal."""
    import scipy

    grid = np.meshgrid(states.x, states.y, np.linspace(0.0, 1.0, 11), indexing="ij")
    x, y, push = (values.ravel() for values in grid)
    index, weights, outside = states.corners(*steps.after(x, y, push))
    shape = len(states.x) * len(states.y), 11
    rows = np.arange(0, index.size + 1, 4)
    after = scipy.sparse.csr_matrix((weights.ravel(), index.ravel(), rows), shape=(len(x), shape[0]))
    # A cell away from the goal costs a tenth of full effort all the time; leaving the grid costs more than anything.
    full = n_steps * steps.step_s
    cost = (steps.cost(x, push) + np.where(outside, 1e3 * full, 0.0)).reshape(shape)
    missed = [np.abs(axis - end) / (axis[1] - axis[0]) for axis, end in zip((states.x, states.y), goal, strict=True)]
    least = [0.1 * full * (missed[0][:, None] + missed[1]).ravel()]
    for _ in range(n_steps):
        least.append(((after @ least[-1]).reshape(shape) + cost).min(axis=1))
    return least


def _followed(steps: _Steps, states: _States, least: list[np.ndarray], start: np.ndarray) -> np.ndarray:
    """Return the states (n_steps + 1, 2) from a start, with the push of least cost in every step."""
    push = np.linspace(0.0, 1.0, 81)
    path = [start]
    for to_go in least[-2::-1]:
        x, y = (np.full(len(push), value) for value in path[-1])
        ahead = steps.after(x, y, push)
        index, weights, _ = states.corners(*ahead)
        best = int(np.argmin(steps.cost(x, push) + (weights * to_go[index]).sum(axis=1)))
        path.append(np.array([ahead[0][best], ahead[1][best]]))
    return np.array(path)


def _guess(part: Part, duration: float, position: np.ndarray, velocity: np.ndarray, start_pose: np.ndarray) -> Guess:
    """Return positions and velocities (n,) at equal time steps as a guess with exact ends, efforts by inverse dynamics."""
    import scipy

    position[[0, -1]], velocity[[0, -1]] = part.places[[0, -1]], part.speeds
    times = np.linspace(0.0, duration, len(position))
    path = scipy.interpolate.CubicHermiteSpline(times, position[:, None], velocity[:, None])
    # Speeds below a fiftieth of the largest are no swing.
    way = np.sign(velocity[np.abs(velocity) > 0.02 * np.abs(velocity).max()])
    return guess_along(path, duration, start_pose, swings=1 + int(np.count_nonzero(np.diff(way))))
