"""The influence of each imperfection on each tracker and metric, from the results of a sensitivity design."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.folders import plain_record
from linkplan.planner.problem.imperfections import Factor
from linkplan.studies.variations.experiment.design import ends_of, varied
from linkplan.studies.variations.experiment.metrics import Metric, metrics_of
from linkplan.studies.variations.experiment.statistics import Estimate
from linkplan.studies.variations.sensitivity.influence import Influence, influence_of
from linkplan.studies.variations.sensitivity.scheme import MORRIS, ONE_AT_A_TIME, SOBOL, SamplingScheme

SUCCESS = "success"
_SUCCESS = Metric(text="share of successes", unit="1", better="more")
# The definition of importance in each design.
MEASURES = {
    ONE_AT_A_TIME: "change between the ends of the range, all else in the middle",
    MORRIS: "mean absolute change across the range (Morris' mu*)",
    SOBOL: "share of the variance that involves it, alone or with others (total Sobol index)",
}


CHANCE = "noise draw"


class Varied(Struct, frozen=True, kw_only=True):
    """An imperfection that was varied: its unit and the ends of its range; no ends for the noise draw."""

    unit: str
    range: tuple[float, float] | None


class MetricInfluence(Struct, frozen=True, kw_only=True, eq=False):
    """The influence on one metric of one tracker: see `Influence`.

    `ranking` has the labels of the imperfections in decreasing order of importance. `effects` has by label the importance,
    its interval and the additional values; None for values that are not finite.
    """

    middle: float | None
    left_out: int
    ranking: tuple[str, ...]
    effects: dict[str, dict[str, Any]]


class Sensitivity(Struct, frozen=True, kw_only=True, eq=False):
    """Influences by tracker and metric, from `groups` of `group_size` machines each.

    `metrics` have the text and the unit of each metric and the unit of its importances (1 for Sobol's shares).
    """

    design: str
    measure: str
    groups: int
    group_size: int
    imperfections: dict[str, Varied]
    metrics: dict[str, dict[str, str]]
    trackers: dict[str, dict[str, MetricInfluence]]

    def importance(self, tracker: str, metric: str, label: str) -> Estimate:
        """Return the importance of an imperfection with its interval."""
        one = self.trackers[tracker][metric]
        effect = one.effects[label]
        value, low, high = (np.nan if x is None else x for x in (effect["importance"], *effect["interval95"]))
        return Estimate(value=value, interval95=(low, high), n=self.groups - one.left_out)

    def ranking(self, tracker: str, metric: str) -> tuple[str, ...]:
        """Return the labels of the imperfections in decreasing order of importance."""
        return self.trackers[tracker][metric].ranking

    @property
    def mains(self) -> tuple[str, ...]:
        """The rms errors, of hinges and of slides."""
        return tuple(name for name in self.metrics if name.startswith("rms_error"))


def sensitivity_of(
    scheme: SamplingScheme,
    factors: Sequence[Factor],
    results: Mapping[str, np.ndarray],
    trackers: Sequence[str],
    mechanism: Mechanism,
    seed: int,
) -> Sensitivity:
    """Return the sensitivity from the columns of results, which hold all machines of a scheme in order for each tracker."""
    known = {**metrics_of(mechanism), SUCCESS: _SUCCESS}
    which = [factors[i] for i in varied(factors)]
    labelled = {one.label: Varied(unit=_unit(one, mechanism), range=ends_of(one)) for one in which}
    labelled |= {CHANCE: Varied(unit="", range=None)} if scheme.noisy else {}
    rows = {tracker: np.flatnonzero(results["tracker"] == tracker) for tracker in trackers}
    shares = scheme.design == SOBOL
    return Sensitivity(
        design=scheme.design,
        measure=MEASURES[scheme.design],
        groups=scheme.n_groups,
        group_size=scheme.size,
        imperfections=labelled,
        metrics={
            name: {"text": metric.text, "unit": "1" if shares else metric.unit, "metric_unit": metric.unit}
            for name, metric in known.items()
        },
        trackers={
            tracker: {
                name: _by_label(influence_of(scheme, results[name][rows[tracker]].astype(float), seed), [*labelled])
                for name in known
            }
            for tracker in trackers
        },
    )


def _by_label(one: Influence, labels: Sequence[str]) -> MetricInfluence:
    effects = {
        label: {
            "importance": one.importance[i],
            "interval95": (one.low[i], one.high[i]),
            **{name: values[i] for name, values in one.parts.items()},
        }
        for i, label in enumerate(labels)
    }
    return MetricInfluence(
        middle=one.middle if np.isfinite(one.middle) else None,
        left_out=one.left_out,
        ranking=tuple(labels[int(i)] for i in one.order),
        effects=plain_record(effects),
    )


def _unit(factor: Factor, mechanism: Mechanism) -> str:
    """Return the unit of a factor's values, for a hinge or for a slide."""
    rotary, _, linear = factor.quantity.unit.partition(" or ")
    kinds = {joint.name: joint.kind == "slide" for joint in mechanism.joints} if factor.quantity.of == "joint" else {}
    if factor.quantity.of == "actuator":
        kinds = {actuator.name: actuator.unit == "N" for actuator in mechanism.actuators}
    return linear if linear and kinds.get(factor.name) else rotary if factor.name in kinds else factor.quantity.unit
