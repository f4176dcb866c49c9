"""What is measured of a run: every figure with its unit and its direction."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkplan.controllers.reference import SampledReference, state_at
from linkplan.controllers.simulate import Ensemble
from linkplan.models.mechanism import Mechanism


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A figure of a run: what it is, its unit, and whether less of it is better ("less", "more", "" for neither)."""

    text: str
    unit: str
    better: str = "less"


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Yardstick:
    """What runs of one plan are measured against.

    `tube` (n_s,) [rad or m] is the tolerance about the path; `end_s` [s] when the motion ends and only holds, or None.
    """

    mechanism: Mechanism
    reference: SampledReference
    tube: np.ndarray
    end_s: float | None
    effort_limit: np.ndarray


def metrics_of(mechanism: Mechanism) -> Mapping[str, Metric]:
    """Return the metrics of a mechanism's runs by name, the unit of errors in their names."""
    efforts = list(dict.fromkeys(actuator.unit for actuator in mechanism.actuators))
    effort = efforts[0] if len(efforts) == 1 else "N.m or N"
    found: dict[str, Metric] = {}
    for unit in _units(mechanism):
        found |= {
            f"rms_error_{unit}": Metric(text="rms error", unit=unit),
            f"max_error_{unit}": Metric(text="largest error", unit=unit),
            f"final_error_{unit}": Metric(text="final error", unit=unit),
            f"overshoot_{unit}": Metric(text="overshoot beyond the path's range", unit=unit),
        }
    return found | {
        "settling_s": Metric(text="settling into the tube after the motion's end", unit="s"),
        "rms_effort": Metric(text="rms effort", unit=effort),
        "energy_j": Metric(text="mechanical energy, driving and braking", unit="J"),
        "peak_effort": Metric(text="peak effort", unit=effort),
        "saturated_share": Metric(text="share of instants beyond the limit", unit="1"),
        "chatter": Metric(text="total variation of the effort", unit=effort),
        "loop_gap_um": Metric(text="largest gap of the kinematic loop", unit="um"),
    }


def _units(mechanism: Mechanism) -> list[str]:
    return [unit for unit in ("deg", "m") if np.any(_of_unit(mechanism, unit))]


def _of_unit(mechanism: Mechanism, unit: str) -> np.ndarray:
    """Return which independent joints (n_s,) that a tracker has a hand in are measured in a unit."""
    hinge = np.array([joint.kind == "hinge" for joint in mechanism.independent_joints])
    steered = ~np.isin(mechanism.independent, mechanism.passive_dofs)
    return steered & (hinge if unit == "deg" else ~hinge)


@np.errstate(over="ignore", invalid="ignore")  # the square of a large effort
def measured(ensemble: Ensemble, i: int, yardstick: Yardstick) -> dict[str, float]:
    """Return the metrics of simulation i by name; NaN where it was frozen, or there is nothing to measure."""
    mechanism, reference = yardstick.mechanism, yardstick.reference
    names = metrics_of(mechanism)
    if ensemble.failure[i] is not None:
        return dict.fromkeys(names, float("nan"))
    # Copies in one piece: how numpy sums them must not depend on what stands beside them.
    time = np.ascontiguousarray(ensemble.time_s[:, i])
    position = np.ascontiguousarray(ensemble.pose[:, i][:, mechanism.independent])
    commanded, applied = (np.ascontiguousarray(x[:, i]) for x in (ensemble.commanded, ensemble.applied))
    wanted = state_at(reference, time)[0]
    error = wanted - position
    inside = np.all(np.abs(error) <= yardstick.tube, axis=1)
    low, high = yardstick.effort_limit.T
    # A range of the whole path: what lies beyond it was never asked for.
    beyond = np.maximum(np.maximum(position - reference.position.max(axis=0), reference.position.min(axis=0) - position), 0)
    found: dict[str, float] = {}
    for unit in _units(mechanism):
        which, factor = _of_unit(mechanism, unit), 180 / np.pi if unit == "deg" else 1.0
        size = factor * np.linalg.norm(error[:, which], axis=1)
        found |= {
            f"rms_error_{unit}": float(np.sqrt(np.mean(size**2))),
            f"max_error_{unit}": float(size.max()),
            f"final_error_{unit}": float(size[-1]),
            f"overshoot_{unit}": float(factor * np.linalg.norm(beyond[:, which], axis=1).max()),
        }
    period = float(time[1] - time[0]) if len(time) > 1 else reference.period_s
    size = np.sqrt(np.sum(applied**2, axis=1))
    return found | {
        "settling_s": _settling_s(time, inside, yardstick.end_s),
        "rms_effort": float(np.sqrt(np.mean(size**2))),
        "energy_j": float(period * np.sum(np.ascontiguousarray(ensemble.power[:, i]))),
        "peak_effort": float(np.abs(applied).max()),
        "saturated_share": float(np.mean(np.any((commanded < low) | (commanded > high), axis=1))),
        "chatter": float(np.sum(np.abs(np.diff(applied, axis=0)))),
        "loop_gap_um": float(1e6 * ensemble.gap_m[i]),
    }


def _settling_s(time: np.ndarray, inside: np.ndarray, end_s: float | None) -> float:
    """Return how long [s] after the motion's end the error last left the tube; NaN where it is outside in the end."""
    if end_s is None or not inside[-1] or time[-1] <= end_s:
        return float("nan")
    outside = np.flatnonzero(~inside)
    return max(0.0, float(time[outside[-1] + 1]) - end_s) if len(outside) else 0.0


def within_tube(ensemble: Ensemble, i: int, yardstick: Yardstick) -> bool:
    """Return whether simulation i went on to its end and no joint ever left the tube about the path."""
    if ensemble.failure[i] is not None:
        return False
    position = ensemble.pose[:, i][:, yardstick.mechanism.independent]
    error = state_at(yardstick.reference, ensemble.time_s[:, i])[0] - position
    return bool(np.all(np.abs(error) <= yardstick.tube))
