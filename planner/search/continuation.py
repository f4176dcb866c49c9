"""Continuation: motions followed along a parameter, each the start of the next.

The one loop behind motions of ever longer duration, of ever smaller margins to singular poses, and under ever lower limits.
A step that is lost is tried again with the root of its factor (step-length control: Allgower & Georg, Introduction to
Numerical Continuation Methods, SIAM 2003, chapter 6).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

Stage = TypeVar("Stage")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Path(Generic[Stage]):
    """The stages that were passed, in order; `arrived`: whether the parameter's end was reached, or far enough."""

    stages: tuple[Stage, ...]
    arrived: bool


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Steps:
    """How a parameter is changed: from `begin` towards `end`, by a `factor` at a time.

    A lost step is tried again with the root of the factor, `halvings` times at most; `most` steps in all.
    """

    begin: float
    end: float
    factor: float
    halvings: int
    most: int


def followed(
    stage: Stage,
    steps: Steps,
    solve: Callable[[Stage, float], Stage | None],
    *,
    enough: Callable[[Stage, Stage, bool], bool] = lambda _before, _after, _whole: False,
    after_loss: Callable[[Stage], Stage] = lambda stage: stage,
) -> Path[Stage]:
    """Return the stages along a parameter.

    Args:
        stage: at the beginning.
        steps: of the parameter.
        solve: returns the next stage from one and the parameter's next value; None where it is lost.
        enough: whether to end, from a stage, the next, and whether the step between them was a whole one.
        after_loss: returns the stage from which a lost step is tried again.
    """
    stages, value, factor, halvings = [stage], steps.begin, steps.factor, steps.halvings
    way = np.sign(np.log(steps.factor))
    for _ in range(steps.most):
        # The relative distance at which a parameter counts as at its end: rounding.
        if way * (steps.end * (1 - way * 1e-12) - value) <= 0:
            return Path(stages=tuple(stages), arrived=True)
        following = float(way * min(way * value * factor, way * steps.end))
        found = solve(stages[-1], following)
        if found is None:
            if not halvings:
                return Path(stages=tuple(stages), arrived=False)
            factor, halvings = float(np.sqrt(factor)), halvings - 1
            stages[-1] = after_loss(stages[-1])
            continue
        stages.append(found)
        if enough(stages[-2], found, factor == steps.factor):
            return Path(stages=tuple(stages), arrived=True)
        value = following
    return Path(stages=tuple(stages), arrived=False)
