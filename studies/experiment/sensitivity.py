"""The influence of each imperfection on each tracker and metric, from the results of a sensitivity design."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkplan.models.mechanism import Mechanism
from linkplan.planner.problem.imperfections import Factor
from linkplan.studies.experiment.design import ends_of, varied
from linkplan.studies.experiment.metrics import Metric, metrics_of
from linkplan.studies.experiment.statistics import Estimate
from linkplan.studies.sensitivity.influence import Influence, influence_of
from linkplan.studies.sensitivity.scheme import MORRIS, ONE_AT_A_TIME, SOBOL, Scheme

SUCCESS = "success"
_SUCCESS = Metric(text="share of successes", unit="1", better="more")
# The definition of importance in each design.
MEASURES = {
    ONE_AT_A_TIME: "change between the ends of the range, all else in the middle",
    MORRIS: "mean size of the change across the range (Morris' mu*)",
    SOBOL: "share of the variance that it has a part in, by itself or with others (total Sobol index)",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Varied:
    """An imperfection that was varied: its label, unit and the ends of its range; no ends for the noise draw."""

    label: str
    unit: str
    ends: tuple[float, float] | None = None


CHANCE = Varied(label="noise draw", unit="")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Sensitivity:
    """Influences by tracker and metric, with arrays in the order of `factors`, from `groups` of `size` machines each."""

    design: str
    factors: tuple[Varied, ...]
    influences: Mapping[str, Mapping[str, Influence]]
    metrics: Mapping[str, Metric]
    groups: int
    size: int

    def importance(self, tracker: str, metric: str, i: int) -> Estimate:
        """Return the importance of factor i with its interval."""
        one = self.influences[tracker][metric]
        n = one.groups - one.left_out
        return Estimate(value=float(one.importance[i]), low=float(one.low[i]), high=float(one.high[i]), n=n)

    def ranking(self, tracker: str, metric: str) -> tuple[str, ...]:
        """Return the labels of the imperfections in decreasing order of importance."""
        return tuple(self.factors[i].label for i in self.influences[tracker][metric].order)

    def unit(self, metric: str) -> str:
        """Return the unit of importances: the metric's unit, or 1 for Sobol's shares."""
        return "1" if self.design == SOBOL else self.metrics[metric].unit

    @property
    def mains(self) -> tuple[str, ...]:
        """The rms errors, of hinges and of slides."""
        return tuple(name for name in self.metrics if name.startswith("rms_error"))


def sensitivity_of(
    scheme: Scheme,
    factors: Sequence[Factor],
    results: Mapping[str, np.ndarray],
    trackers: Sequence[str],
    mechanism: Mechanism,
    seed: int,
) -> Sensitivity:
    """Return the sensitivity from the columns of results, which hold all machines of a scheme in order for each tracker."""
    known = {**metrics_of(mechanism), SUCCESS: _SUCCESS}
    which = [factors[i] for i in varied(factors)]
    labelled = [Varied(label=one.label, unit=_unit(one, mechanism), ends=ends_of(one)) for one in which]
    rows = {tracker: np.flatnonzero(results["tracker"] == tracker) for tracker in trackers}
    influences = {
        tracker: {name: influence_of(scheme, results[name][rows[tracker]].astype(float), seed) for name in known}
        for tracker in trackers
    }
    return Sensitivity(
        design=scheme.design,
        factors=(*labelled, CHANCE) if scheme.noisy else tuple(labelled),
        influences=influences,
        metrics=known,
        groups=scheme.n_groups,
        size=scheme.size,
    )


def _unit(factor: Factor, mechanism: Mechanism) -> str:
    """Return the unit of a factor's values, for a hinge or for a slide."""
    rotary, _, linear = factor.quantity.unit.partition(" or ")
    kinds = {joint.name: joint.kind == "slide" for joint in mechanism.joints} if factor.quantity.of == "joint" else {}
    if factor.quantity.of == "actuator":
        kinds = {actuator.name: actuator.unit == "N" for actuator in mechanism.actuators}
    return linear if linear and kinds.get(factor.name) else rotary if factor.name in kinds else factor.quantity.unit


def sensitivity_record(sensitivity: Sensitivity) -> dict:
    """Return a sensitivity as a JSON record: ranking and importances for each tracker and metric."""
    labels = [factor.label for factor in sensitivity.factors]
    found: dict[str, dict] = {}
    for tracker, by_metric in sensitivity.influences.items():
        found[tracker] = {}
        for metric, one in by_metric.items():
            effects = {
                label: {
                    "importance": one.importance[i],
                    "interval95": [one.low[i], one.high[i]],
                    **{name: values[i] for name, values in one.parts.items()},
                }
                for i, label in enumerate(labels)
            }
            found[tracker][metric] = {
                "middle": one.middle,
                "left_out": one.left_out,
                "ranking": list(sensitivity.ranking(tracker, metric)),
                "effects": effects,
            }
    return {
        "design": sensitivity.design,
        "measure": MEASURES[sensitivity.design],
        "groups": sensitivity.groups,
        "group_size": sensitivity.size,
        "imperfections": {
            factor.label: {"unit": factor.unit, "range": None if factor.ends is None else list(factor.ends)}
            for factor in sensitivity.factors
        },
        "metrics": {
            name: {"text": metric.text, "unit": sensitivity.unit(name), "metric_unit": metric.unit}
            for name, metric in sensitivity.metrics.items()
        },
        "trackers": found,
    }
