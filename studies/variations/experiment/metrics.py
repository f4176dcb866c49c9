"""The metrics of a run, each with its unit and direction."""

from collections.abc import Mapping

import numpy as np
from msgspec import Struct

from linkplan.controllers.imperfections.plant import held_before
from linkplan.controllers.reference import state_at
from linkplan.controllers.simulate import Ensemble
from linkplan.models.mechanism import Mechanism
from linkplan.studies.compare.compare import ERRORS, actuated_by_unit, error_figures
from linkplan.studies.variations.experiment.experiment import Experiment


class Metric(Struct, frozen=True, kw_only=True):
    """A metric of a run: its description, its unit, and the better direction ("less", "more" or "")."""

    text: str
    unit: str
    better: str = "less"


def metrics_of(mechanism: Mechanism) -> Mapping[str, Metric]:
    """Return the metrics of a mechanism's runs by name; names of errors contain the unit."""
    efforts = list(dict.fromkeys(actuator.unit for actuator in mechanism.actuators))
    effort = efforts[0] if len(efforts) == 1 else "N.m or N"
    found: dict[str, Metric] = {}
    for unit in actuated_by_unit(mechanism):
        found |= {f"{name}_error_{unit}": Metric(text=text, unit=unit) for name, text in ERRORS.items()}
        found[f"overshoot_{unit}"] = Metric(text="overshoot beyond the path's range", unit=unit)
    return found | {
        "settling_s": Metric(text="settling into the tube after the motion's end", unit="s"),
        "rms_effort": Metric(text="rms effort", unit=effort),
        "energy_j": Metric(text="mechanical energy, driving and braking", unit="J"),
        "peak_effort": Metric(text="peak effort", unit=effort),
        "saturated_share": Metric(text="share of instants beyond the limit", unit="1"),
        "chatter": Metric(text="total variation of the effort", unit=effort),
        "loop_gap_um": Metric(text="largest gap of the kinematic loop", unit="um"),
    }


@np.errstate(over="ignore", invalid="ignore")  # overflow of the square of a large effort
def measured(ensemble: Ensemble, i: int, experiment: Experiment) -> dict:
    """Return success, failure and the metrics of simulation i by name; NaN if it was frozen, or if a metric does not apply.

    A run succeeds if it was completed and every joint stayed inside the tube about the path.
    """
    mechanism, reference, failure = experiment.plan.problem.mechanism, experiment.reference, ensemble.failure[i]
    if failure is not None:
        return {"failure": failure, "success": False} | dict.fromkeys(metrics_of(mechanism), float("nan"))
    # Contiguous copies, so that numpy's order of summation does not depend on the number of simulations.
    time = np.ascontiguousarray(ensemble.time_s[:, i])
    position = np.ascontiguousarray(ensemble.pose[:, i][:, mechanism.independent])
    commanded, applied = (np.ascontiguousarray(x[:, i]) for x in (ensemble.commanded, ensemble.applied))
    wanted = state_at(reference, time)[0]
    error = wanted - position
    inside = np.all(np.abs(error) <= experiment.tube, axis=1)
    # Overshoot is the distance beyond the range of the whole path.
    beyond = np.maximum(
        np.maximum(position - reference.position_rad.max(axis=0), reference.position_rad.min(axis=0) - position), 0
    )
    found = {"failure": None, "success": bool(np.all(inside))} | error_figures(mechanism, error)
    for unit, (which, factor) in actuated_by_unit(mechanism).items():
        found[f"overshoot_{unit}"] = float(factor * np.linalg.norm(beyond[:, which], axis=1).max())
    period = float(time[1] - time[0]) if len(time) > 1 else reference.period_s
    size = np.sqrt(np.sum(applied**2, axis=1))
    held = held_before(mechanism, reference, experiment.loop)
    return found | {
        "settling_s": _settling_s(time, inside, experiment.end_s),
        "rms_effort": float(np.sqrt(np.mean(size**2))),
        "energy_j": float(period * np.sum(np.ascontiguousarray(ensemble.power[:, i]))),
        "peak_effort": float(np.abs(applied).max()),
        "saturated_share": float(np.mean(experiment.loop.saturates(commanded, period, held))),
        "chatter": float(np.sum(np.abs(np.diff(applied, axis=0)))),
        "loop_gap_um": float(1e6 * ensemble.gap_m[i]),
    }


def _settling_s(time: np.ndarray, inside: np.ndarray, end_s: float | None) -> float:
    """Return the time [s] from the motion's end until the error stays inside the tube; NaN if it never does."""
    if end_s is None or not inside[-1] or time[-1] <= end_s:
        return float("nan")
    outside = np.flatnonzero(~inside)
    return max(0.0, float(time[outside[-1] + 1]) - end_s) if len(outside) else 0.0
