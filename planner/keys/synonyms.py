"""Synonyms: names from other programs and plain speech, and the keys that they stand for."""

from collections.abc import Iterable, Mapping

from linkplan.models.names import closest

# If a synonym stands for several keys, the one that the table has is suggested.
SYNONYMS: Mapping[str, tuple[str, ...]] = {
    "torque": ("effort",),
    "force": ("effort", "closure_force"),
    "torque_rate": ("effort_rate",),
    "position_deg": ("range_deg", "start_deg"),
    "velocity_deg_s": ("speed_deg_s",),
    "time": ("duration_s", "time_s"),
    "duration": ("duration_s",),
    "cost": ("minimize", "objective"),
    "type": ("kind",),
    "from_deg": ("start_deg",),
    "to_deg": ("goal_deg",),
    "end_deg": ("goal_deg",),
    "via": ("waypoints",),
    "file": ("model",),
    "robot": ("mechanism",),
    "mass": ("mass_kg",),
    "method": ("scheme",),
    "nodes": ("intervals",),
    "timeout_s": ("max_time_s",),
    "dt": ("period_s",),
    "delay": ("delay_periods",),
}


def suggestion(asked: str, legal: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the legal name that a synonym stands for or that is closest; "" if none is close."""
    legal = list(legal)
    synonyms = (name for name in SYNONYMS.get(str(asked).casefold(), ()) if name in legal)
    match = next(synonyms, None) or closest(asked, legal)
    return "" if match is None else f" (did you mean '{match}'?)"
