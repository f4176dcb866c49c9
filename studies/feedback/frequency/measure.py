"""Frequency responses measured in MuJoCo about operating points; see `excitation` for the signals."""

from collections.abc import Callable, Sequence

import numpy as np

from linkplan.models.errors import LinkplanError
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.frequency import sinestream
from linkplan.studies.feedback.frequency.excitation import EXCITATIONS, Measurement, Setup
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop


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
        loops: from `feedback_loops.feedback_loop`. Their gains and points are simulated; their predictions scale the
            signals.
        frequency_hz: (n,), moved so that a period has whole samples.
        effort_limit: of the actuators (n_u, 2) [N.m or N].
        setup: the settings of the measurement.
        excitations: keys of EXCITATIONS.
        channel: index of the excited joint among the independent joints.
        say: receives progress messages.

    Raises:
        LinkplanError: for frequencies above the Nyquist frequency, or an unstable loop.
    """
    setup = Setup() if setup is None else setup
    refuse_unstable(loops)
    return sinestream.run(loops, frequency_hz, effort_limit, setup, tuple(excitations), channel, say)


def refuse_unstable(loops: Sequence[FeedbackLoop]) -> None:
    """Refuse loops that are unstable or continuous."""
    for loop in loops:
        if loop.radius is None:
            raise LinkplanError("a continuous feedback loop cannot be run in MuJoCo: measure a sampled one")
        if not loop.stable:
            raise LinkplanError(
                f"the feedback loop at {loop.point.name} is unstable and cannot be measured: its largest pole is"
                f" {loop.radius:.4g}, above 1"
            )
