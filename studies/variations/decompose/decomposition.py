"""The result of a decomposition, whose fields are the record `decompose.json`."""

from typing import Any

from msgspec import Struct


class Shares(Struct, frozen=True, kw_only=True):
    """The parts of one tracker's rms error, in the error's unit, by cause.

    The `parts` add up to `rms_error`, and so do the `parts_of_joints` over joints and causes. `rms_of_increment` are the rms
    values of each cause's increment; `rms_error_on_rung` is the rms error after each cause is switched on.
    """

    rms_error: float
    parts: dict[str, float]
    parts_of_joints: dict[str, dict[str, float]]
    rms_of_increment: dict[str, float]
    rms_error_on_rung: dict[str, float]


class TrackerShares(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The parts of one tracker's error over the `machines` without a failure, in deg and m, and the failures."""

    machines: int
    failures: dict[str, int]
    deg: Shares | None = None
    m: Shares | None = None

    @property
    def by_unit(self) -> dict[str, Shares]:
        """The parts by the unit of the error."""
        return {unit: shares for unit, shares in (("deg", self.deg), ("m", self.m)) if shares is not None}


class Decomposition(Struct, frozen=True, kw_only=True):
    """The causes of the errors of trackers on one plan; `parts` are the causes' names and descriptions."""

    decomposition: str
    machines: int
    seed: int
    imperfections: dict[str, Any]
    control_period_s: float
    delay_periods: float
    timestep_s: float
    duration_s: float
    parts: dict[str, str]
    trackers: dict[str, TrackerShares]

    @property
    def found(self) -> bool:
        """True if every tracker has at least one machine without a failure."""
        return all(one.machines for one in self.trackers.values())
