"""What a simulated machine's imperfections are drawn from: one spread of values for each, in a problem file's units.

Planning knows nothing of them: they are kept for studies that run trackers on machines unlike the model.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from linkplan.models.errors import ProblemError
from linkplan.models.names import nearest
from linkplan.planner.problem.values import number

_MOST = 1e9


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantity:
    """A quantity that can be wrong: its unit, what is legal, and what has one each.

    `of` is "" for the whole machine, "hinge" or "slide" (independent joints of that kind), "joint" (any), "actuator" or
    "body".
    """

    unit: str
    low: float
    high: float
    of: str = ""


QUANTITIES: Mapping[str, Quantity] = {
    "period_factor": Quantity(unit="1", low=0.5, high=2.0),
    "phase_periods": Quantity(unit="control periods", low=0.0, high=1.0),
    "delay_periods": Quantity(unit="control periods", low=0.0, high=1000.0),
    "encoder_resolution_deg": Quantity(unit="deg", low=0.0, high=360.0, of="hinge"),
    "encoder_resolution_m": Quantity(unit="m", low=0.0, high=_MOST, of="slide"),
    "encoder_offset_deg": Quantity(unit="deg", low=-360.0, high=360.0, of="hinge"),
    "encoder_offset_m": Quantity(unit="m", low=-_MOST, high=_MOST, of="slide"),
    "position_noise_deg": Quantity(unit="deg", low=0.0, high=360.0, of="hinge"),
    "position_noise_m": Quantity(unit="m", low=0.0, high=_MOST, of="slide"),
    "velocity_noise_deg_s": Quantity(unit="deg/s", low=0.0, high=_MOST, of="hinge"),
    "velocity_noise_m_s": Quantity(unit="m/s", low=0.0, high=_MOST, of="slide"),
    "velocity_filter_hz": Quantity(unit="Hz", low=1e-6, high=_MOST),
    "torque_resolution": Quantity(unit="N.m or N", low=0.0, high=_MOST, of="actuator"),
    "torque_bandwidth_hz": Quantity(unit="Hz", low=1e-6, high=_MOST, of="actuator"),
    "torque_rate": Quantity(unit="N.m/s or N/s", low=1e-9, high=1e15, of="actuator"),
    "torque_constant_factor": Quantity(unit="1", low=0.01, high=100.0, of="actuator"),
    "viscous_friction": Quantity(unit="N.m.s/rad or N.s/m", low=0.0, high=_MOST, of="joint"),
    "coulomb_friction": Quantity(unit="N.m or N", low=0.0, high=_MOST, of="joint"),
    "payload_mass_factor": Quantity(unit="1", low=1e-3, high=1e3),
    "payload_com_x_m": Quantity(unit="m", low=-_MOST, high=_MOST),
    "payload_com_y_m": Quantity(unit="m", low=-_MOST, high=_MOST),
    "payload_com_z_m": Quantity(unit="m", low=-_MOST, high=_MOST),
    "link_length_factor": Quantity(unit="1", low=0.1, high=10.0, of="body"),
    "push_start_s": Quantity(unit="s", low=0.0, high=_MOST),
    "push_duration_s": Quantity(unit="s", low=0.0, high=_MOST),
    "push_force_x_n": Quantity(unit="N", low=-_MOST, high=_MOST),
    "push_force_y_n": Quantity(unit="N", low=-_MOST, high=_MOST),
    "push_force_z_n": Quantity(unit="N", low=-_MOST, high=_MOST),
    "push_effort": Quantity(unit="N.m or N", low=-_MOST, high=_MOST),
    "start_error_deg": Quantity(unit="deg", low=-360.0, high=360.0, of="hinge"),
    "start_error_m": Quantity(unit="m", low=-_MOST, high=_MOST, of="slide"),
    "start_velocity_error_deg_s": Quantity(unit="deg/s", low=-_MOST, high=_MOST, of="hinge"),
    "start_velocity_error_m_s": Quantity(unit="m/s", low=-_MOST, high=_MOST, of="slide"),
    "loop_time_constant_s": Quantity(unit="s", low=1e-9, high=_MOST),
    "loop_damping_ratio": Quantity(unit="1", low=1e-3, high=1e3),
}
# Names of what is pushed: words, not spreads.
WORDS = ("push_body", "push_joint")
KEYS = (*QUANTITIES, *WORDS)
_FORMS = "a number, a range [low, high], { uniform = [low, high] } or { normal = [mean, std] }"


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Where a value lies: "fixed" at `first`, "uniform" from `first` to `second`, or "normal" with mean and deviation."""

    kind: str
    first: float
    second: float = 0.0

    @property
    def random(self) -> bool:
        """Whether different machines have different values."""
        return (self.kind == "normal" and self.second > 0) or (self.kind == "uniform" and self.second > self.first)


@dataclass(frozen=True, slots=True, kw_only=True)
class Factor:
    """One number of a machine that can be wrong: which quantity, of what (a joint, actuator or body; "" of all), and how."""

    key: str
    name: str
    spread: Spread

    @property
    def label(self) -> str:
        """The key, and what it is of."""
        return f"{self.key}.{self.name}" if self.name else self.key

    @property
    def quantity(self) -> Quantity:
        """The quantity that the key names."""
        return QUANTITIES[self.key]


def is_spread(value: object) -> bool:
    """Return whether a table is a distribution, and no table of values by name."""
    return isinstance(value, Mapping) and bool(value) and set(value) <= {"normal", "uniform"}


def spread_of(value: object, key: str, label: str) -> Spread:
    """Return the spread that a file's value means.

    Raises:
        ProblemError: when it is none, or lies outside of what is legal for the key.
    """
    where = f"imperfections.{label}"
    kind, pair = "uniform", value
    if isinstance(value, Mapping):
        if not is_spread(value) or len(value) != 1:
            raise ProblemError(f"{where} is {_FORMS}, got {value!r}")
        ((kind, pair),) = value.items()
    if not isinstance(pair, list | tuple):
        if isinstance(value, Mapping | bool) or not isinstance(value, int | float):
            raise ProblemError(f"{where} is {_FORMS}, got {value!r}")
        return Spread(kind="fixed", first=_legal(value, key, where))
    if len(pair) != 2:
        raise ProblemError(f"{where} is {_FORMS}, got {value!r}")
    first = _legal(pair[0], key, where)
    if kind == "normal":
        return Spread(kind=kind, first=first, second=number(pair[1], f"{where}: the standard deviation", at_least_zero=True))
    second = _legal(pair[1], key, where)
    if second < first:
        raise ProblemError(f"{where} goes from its low end to its high end, got {value!r}")
    return Spread(kind=kind, first=first, second=second)


def _legal(value: object, key: str, where: str) -> float:
    found, quantity = number(value, where), QUANTITIES[key]
    if not quantity.low <= found <= quantity.high:
        unit = "" if quantity.unit == "1" else f" [{quantity.unit}]"
        raise ProblemError(f"{where} is from {quantity.low:g} to {quantity.high:g}{unit}, got {found:g}")
    return found


def refuse_unknown(table: Mapping) -> None:
    """Refuse keys that are none.

    Raises:
        ProblemError: with the nearest key.
    """
    for key in table:
        if key not in KEYS:
            raise ProblemError(f"unknown key 'imperfections.{key}'{nearest(key, KEYS)}; keys are {', '.join(KEYS)}")
