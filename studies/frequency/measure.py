"""Frequency responses measured in MuJoCo, about operating points see `excitation`."""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.planning import silent
from linkplan.studies.frequency import broadband, sinestream
from linkplan.studies.frequency.excitation import EXCITATIONS, Measurement, Setup
from linkplan.studies.frequency.feedback_loops import FeedbackLoop


def measure(
    loops: Sequence[FeedbackLoop],
    frequency_hz: np.ndarray,
    effort_limit: np.ndarray,
    setup: Setup | None = None,
    *,
    excitations: Sequence[str] = tuple(EXCITATIONS),
    channel: int = 0,
    say: Callable[[str], None] = silent,
) -> Measurement:
    """Return the responses of loops of one mechanism and one timing, measured in MuJoCo about their operating points.

    Args:
        loops: predicted by `feedback_loops.feedback_loop`; their gains and points are run, their predictions scale the
            signals.
        frequency_hz: where to measure, moved to whole samples a period.
        effort_limit: of the actuators (n_u, 2) [N.m or N].
        setup: how.
        excitations: which signals, see EXCITATIONS.
        channel: the joint that moves, by index of the independent ones, and its actuator.
        say: hears about progress.

    Raises:
        LinkplanError: for frequencies above Nyquist, or a loop that is not stable: it holds no operating point.
    """
    setup = Setup() if setup is None else setup
    refuse_unstable(loops)
    run = sinestream.run if setup.method == "sinestream" else broadband.run
    return run(loops, frequency_hz, effort_limit, setup, tuple(excitations), channel, say)


def refuse_unstable(loops: Sequence[FeedbackLoop]) -> None:
    """Refuse loops that hold no operating point."""
    for loop in loops:
        if loop.radius is None:
            raise LinkplanError("a continuous feedback loop cannot be run in MuJoCo: measure a sampled one")
        if not loop.stable:
            raise LinkplanError(
                f"the feedback loop at {loop.point.name} is unstable and cannot be measured: its largest pole is"
                f" {loop.radius:.4g}, above 1"
            )
