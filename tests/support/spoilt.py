"""Correct and spoilt motions of any mechanism, with limits of all kinds put beside what they need."""

from dataclasses import dataclass, replace

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.proof.finding import Proof
from linkplan.planner.proof.prove import prove
from linkplan.planner.trajectory import Trajectory
from tests.support.limit_kinds import Kind, kinds_of
from tests.support.random_motions import motion_of, samples_at

# Below this, a millionth of a limit is no more than the allowance for rounding, 1e-9 of its unit.
_SMALLEST = 2e-3


def largest(kind: Kind, problem: Problem, motion: Trajectory, sign: int) -> float:
    """Return the largest of sign x values along a motion: a fine grid, refined about the three largest."""

    def at(time: np.ndarray) -> np.ndarray:
        return sign * kind.values(samples_at(problem, motion, time))

    grid = motion.times_at(np.append(np.linspace(0, 1, 100, endpoint=False), 1 - 1e-12))
    values = at(grid)
    tops = np.flatnonzero((values >= np.append(values[1:], -np.inf)) & (values >= np.append(-np.inf, values[:-1])))
    best = float(values.max())
    for top in sorted(tops, key=lambda k: -values[k])[:3]:
        time = grid[max(top - 1, 0) : top + 2]
        for _ in range(6):  # a largest value at a kink is found to the last spacing only
            time = np.linspace(time[0], time[-1], 41)
            found = at(time)
            k = int(np.argmax(found))
            best, time = max(best, float(found[k])), time[max(k - 1, 0) : k + 2]
    return best


def moved(motion: Trajectory, at: tuple, by: float, *, effort: bool) -> Trajectory:
    """Return a motion with one coefficient moved: of the effort, or of the position with its velocity."""
    name = "effort" if effort else "position"
    coefficients = np.array(getattr(motion, name))
    coefficients[at] += by
    if effort:
        return replace(motion, effort=coefficients)
    widths = np.diff(motion.breaks_s)[:, None]
    return replace(motion, position=coefficients, velocity=(len(coefficients) - 1) * np.diff(coefficients, axis=0) / widths)


def spoilt(motion: Trajectory, rng: np.random.Generator, *, effort: bool) -> Trajectory:
    """Return a motion with one coefficient moved by a thousandth of their span, so that the pieces still join smoothly."""
    coefficients = motion.effort if effort else motion.position
    away = 1 if effort else 2  # from the ends of the interval
    k, item = (int(rng.integers(n)) for n in coefficients.shape[1:])
    at = int(rng.integers(away, len(coefficients) - away)), k, item
    by = 1e-3 * max(float(np.ptp(coefficients[:, :, item])), 1e-9) * float(rng.choice([-1, 1]))
    return moved(motion, at, by, effort=effort)


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What a proof said of a limit, placed beside the largest value of a motion."""

    words: str
    case: str
    expected: str
    answers: tuple[str, ...]
    reason: str

    @property
    def right(self) -> bool:
        """Whether the answer is the expected one."""
        return self.answers == (self.expected,)


def answers_beside_limits(mechanism: Mechanism, rng: np.random.Generator) -> list[Answer]:
    """Return the answers on a random motion of a mechanism, next to limits of all kinds.

    A correct plan stays 1e-9 of a limit below it, or below the mark where that has an allowance. A plan with a moved
    coefficient is 1e-6 beyond the mark.
    """
    problem, motion = motion_of(mechanism, rng)
    kinds = kinds_of(problem, motion, rng)
    groups = [
        [kind for kind in kinds if not kind.of_effort and " with " not in kind.words],
        [kind for kind in kinds if kind.of_effort],
        [kind for kind in kinds if " with " in kind.words],
    ]
    found = []
    for group in groups:
        signs = [int(rng.choice(kind.signs)) for kind in group]
        effort = any(kind.of_effort for kind in group)
        bad = spoilt(motion, rng, effort=effort)
        for case, expected, moving, share in (
            ("1e-9 below", "proved", motion, 1e-9),
            ("1e-6 beyond", "refuted", bad, -1e-6),
        ):
            beside, chosen = problem, []
            for kind, sign in zip(group, signs, strict=True):
                top = largest(kind, problem, moving, sign)
                scale = float(np.ptp(kind.values(samples_at(problem, moving, moving.dense_times()))))
                absolute = not kind.words.startswith(("effort of", "planned effort of"))
                if abs(top) < 1e-3 * scale or absolute * abs(top) < _SMALLEST:
                    continue  # a limit at zero has no share
                limit = top + (share - kind.beyond) * abs(top)
                ends = (-np.inf, limit) if sign > 0 else (-limit, np.inf)
                beside, chosen = kind.limited(beside, *ends), [*chosen, kind]
            proof = prove(beside, moving, existence=False)
            found += [_answer(proof, kind, case, expected) for kind in chosen]
    return found


def _answer(proof: Proof, kind: Kind, case: str, expected: str) -> Answer:
    own = [finding for finding in proof.findings if not finding.name.startswith("the pieces of")]
    of = [finding for finding in own if kind.words in finding.name]
    answers = tuple(sorted({finding.answer for finding in of}))
    reason = "; ".join(finding.reason or f"bound {finding.bound}, mark {finding.mark}" for finding in of)
    return Answer(words=kind.words, case=case, expected=expected, answers=answers, reason=reason)
