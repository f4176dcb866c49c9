"""The built-in trackers and their properties, in a separate file so that listing them loads no numerical libraries."""

import importlib
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class BuiltInTracker:
    """A built-in tracker.

    Args:
        built: "FILE:FUNCTION", a function in a file of this folder that returns the tracker for a `Design`.
        words: its name in sentences.
        colour: the index of its colour, the same everywhere, among the seven of lines.
        linear: whether it is a linear state feedback whose gain follows from the pose. Frequency responses and tuning
            support these, and a comparison uses them by default.
        by_errors: whether its gains follow from errors of unit cost, and not from `kp` and `kd`.
        in_c: whether it is linear in the state along a motion, so that it is exported as tables in C.
    """

    built: str
    words: str
    colour: int
    linear: bool = False
    by_errors: bool = False
    in_c: bool = False

    def build(self, design: Any) -> Any:
        """Return the tracker for a `Design`."""
        file, function = self.built.split(":")
        return getattr(importlib.import_module(f"{__package__}.{file}"), function)(design)


BUILT_IN = {
    "pd": BuiltInTracker(built="pd:pd_for", words="PD", colour=1, linear=True, in_c=True),
    "pd+ff": BuiltInTracker(built="pd:pd_ff_for", words="PD with feedforward", colour=2, linear=True, in_c=True),
    "lqr": BuiltInTracker(built="lqr:lqr", words="LQR", colour=0, linear=True, by_errors=True, in_c=True),
    "lqi": BuiltInTracker(built="integral_lqr:lqi", words="LQR with integral action", colour=5, by_errors=True),
    "gs-pd+ff": BuiltInTracker(built="pd:gs_pd_ff_for", words="gain-scheduled PD with feedforward", colour=3, in_c=True),
    "ct": BuiltInTracker(built="computed_torque:computed_torque", words="computed torque", colour=6),
    "mpc": BuiltInTracker(built="mpc:mpc", words="model predictive control", colour=4, by_errors=True),
}
TRACKERS = tuple(BUILT_IN)
"""All tracking laws."""

LINEAR = tuple(name for name, one in BUILT_IN.items() if one.linear)
"""Linear state feedback laws."""
