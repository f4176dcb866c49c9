"""The verdict of planning as data; its sentence is made here, last."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from msgspec import Struct, structs

from linkplan.planner.solvers.solve import OUT_OF_TIME, why_stopped

if TYPE_CHECKING:
    from linkplan.planner.limits.limit import Margin
    from linkplan.planner.proof.finding import Finding

Kind = Literal["optimal", "feasible", "infeasible", "failed"]
# By what a verdict is known: a search that may have missed a motion; the phase plane, which misses none; poses, speeds or
# efforts that every motion has; the reference, which the motion follows; the motion's certificate or proof.
KnownBy = Literal["search", "phase plane", "every motion", "reference", "certificate", "proof"]
# What a verdict is about.
About = Literal["motion", "limit", "duration", "time", "numbers", "certificate", "search"]


class Overrun(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A limit that is exceeded: its key in [limits], the joint, actuator, site or closure, the value and the bound.

    Values are in `unit`. `time_s` is the instant [s] of the motion, if there is one.
    """

    limit: str
    name: str
    value: float
    bound: float
    unit: str
    time_s: float | None = None

    @classmethod
    def of(cls, margin: Margin) -> Overrun:
        """Return the overrun of a motion's worst instant."""
        key = getattr(margin.of, "key", margin.what)
        return cls(
            limit=key, name=margin.name, value=margin.value, bound=margin.limit, unit=margin.unit, time_s=margin.time_s
        )

    @classmethod
    def of_finding(cls, one: Finding) -> Overrun:
        """Return the overrun of a limit that a proof refutes, in the unit of its claim."""
        assert one.bound is not None  # of a claim on a limit
        assert one.mark is not None
        return cls(limit=one.limit, name=one.part, value=one.bound, bound=one.mark, unit=one.unit, time_s=one.time_s)


class Verdict(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What planning found, and by what it is known.

    `kind` is "optimal" (converged and certified), "feasible" (certified), "infeasible" or "failed". An optimal motion is
    known to be a global optimum if `is_global`. `overruns` are the limits that are exceeded, the worst first. `remedy` are
    values of keys that would do, such as {"motion.duration_s": 0.31}. `needed_factor` is the factor on all limits of
    the first overrun's kind with which there is a motion. `out_of_time` says that the search ended before it was complete.

    `words` is the motion or the reason as text, `further` are phrases on what was tried and what is not shown.
    """

    kind: Kind
    words: str
    about: About = "motion"
    known_by: KnownBy = "search"
    is_global: bool = False
    objective: str = ""
    overruns: tuple[Overrun, ...] = ()
    remedy: dict[str, float] = {}
    needed_factor: float | None = None
    out_of_time: bool = False
    further: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether there is a motion that passes its certificate."""
        return self.kind in ("optimal", "feasible")

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        if not self.passed:
            first = f"{self.kind}: {self.words}"
        elif self.kind == "optimal" and self.objective:  # no solver shows more than a local optimum
            locally, single = "" if self.is_global else "locally ", " " not in self.objective
            for_sum = "" if single else f", for {self.objective.replace('_', ' ')}"
            of_term = f"{self.objective.replace('_', '-')}-" if single else ""
            first = f"{locally}{of_term}optimal {self.words}{for_sum}"
        else:
            first = self.words
        return "; ".join([first, *self.further])

    def replace(self, **changes: Any) -> Verdict:
        """Return this verdict with changes."""
        return structs.replace(self, **changes)

    def adding(self, *further: str, **changes: Any) -> Verdict:
        """Return this verdict with further phrases, and with changes; empty phrases are omitted."""
        return self.replace(further=(*self.further, *filter(None, further)), **changes)


def infeasible(words: str, about: About = "limit", *, known_by: KnownBy = "search", **more: Any) -> Verdict:
    """Return the verdict that no motion satisfies the limits."""
    return Verdict(kind="infeasible", words=words, about=about, known_by=known_by, **more)


def failed(words: str, about: About = "search", **more: Any) -> Verdict:
    """Return the verdict that no motion was found, without a proof that there is none."""
    return Verdict(kind="failed", words=words, about=about, **more)


def out_of_time(max_time_s: float) -> Verdict:
    """Return the verdict of a search without a motion when its time ended."""
    return failed(why_stopped(OUT_OF_TIME, max_time_s) or "", "time", out_of_time=True)
