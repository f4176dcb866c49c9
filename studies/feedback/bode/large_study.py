"""The study of `linkplan bode --large`: a feedback loop beyond its effort limit, and the feasible amplitudes."""

from collections.abc import Callable

from msgspec.structs import replace

from linkplan.models.errors import LinkplanError
from linkplan.planner.problem.limits import Limits
from linkplan.planner.search.planning import silent
from linkplan.studies.feedback.bode.bode_report import BodeStudy
from linkplan.studies.feedback.frequency.describing import LargeSignals, default_large_frequencies, large_signals
from linkplan.studies.feedback.frequency.feasible import curve_rows, default_amplitudes, feasible_curve


def large_study(study: BodeStudy, limits: Limits | None, say: Callable[[str], None] = silent) -> LargeSignals:
    """Return the large-signal responses at the middle one of a bode study's stable poses.

    Args:
        study: the bode study.
        limits: the planner's limits for the curve; default: the model's.
        say: receives progress messages.

    Raises:
        LinkplanError: if no pose is stable, or the actuator has no limit.
    """
    stable = [entry for entry in study.points if entry.stable and entry.channel == 0]
    if not stable:
        raise LinkplanError("a response beyond the effort limit needs a stable feedback loop, but none of the poses has one")
    entry = stable[len(stable) // 2]
    curve = feasible_curve(
        entry.point,
        default_amplitudes(entry.point),
        study.law.effort_limit,
        position_limit=None if limits is None else limits.position,
        speed_limit=None if limits is None else limits.speed,
    )
    within = curve.amplitude[curve.frequency_hz > 0]
    say(f"large signals at {entry.point.name}")
    signals = large_signals(
        entry.sampled,
        study.law.effort_limit,
        default_large_frequencies(entry.sampled, entry.crossover_hz),
        quantity="reference" if study.law.name == "pd" else "reference+ff",
        farthest=float(within.max()) if within.size else None,
        say=say,
    )
    return replace(signals, feasible=curve_rows(curve), curve=curve)
