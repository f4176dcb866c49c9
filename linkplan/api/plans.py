"""`plan`, `prove`, `Plan`, `read_plan`, `Planner`: from a problem to a certified motion, or the reason for none."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import UNSET, structs

from linkplan.api.command import command
from linkplan.api.inputs import AnyProblem, PlanLike, Source, given_phases, given_problem, plan_of, source_of, with_motion
from linkplan.api.reporting import LOG, Listener, Progress, listener
from linkplan.models.deadline import NO_DEADLINE, OutOfTimeError
from linkplan.models.errors import ProblemError
from linkplan.planner.files.folders import plain_record, write_whole
from linkplan.planner.files.tables import PHASES_FILE
from linkplan.planner.plan import folder as plan_folder
from linkplan.planner.plan import plan as planned
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion, price_of, saved_price, with_price
from linkplan.planner.search.refutations import proved_after_refinement
from linkplan.planner.search.replan import NextMotion, Replanner
from linkplan.planner.search.sensitivities import with_sensitivities
from linkplan.studies.output.paths import check_flags, drawn, path_of
from linkplan.studies.output.result import Reported, Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from linkplan.planner.plan.record import PlanRecord
    from linkplan.planner.proof.prove import Proof
    from linkplan.studies.output.document import Block, Report
    from linkplan.studies.output.phased_plan import PhasedPlan

# Without `prove`, a plan is proved if the proof takes at most this share of the planning time, or this many seconds.
_PROOF_SHARE, _PROOF_SECONDS = 1.0 / 3.0, 1.3
PROVING = "proving the limits, then that the model has a motion near the plan (at most a minute)"


@command("plan a motion and certify it between the nodes", saved=True, showing=("all", "report", "parquet", "jumps"))
def plan(
    problem: AnyProblem,
    progress: Progress | None = None,
    *,
    prove: bool = False,
    sensitivities: bool = False,
) -> Plan | PhasedPlan:
    """Return the plan of a problem; without a motion, its `message` has the reason.

    If the problem has a reserve or ranges, the nominal machine is planned too, to state the price of robustness. The motion
    is proved if the proof takes little time compared with planning; the result is the plan's `proof`.

    Args:
        problem: a `Problem`, a built-in name or the path of a problem file. A motion in phases gives a `PhasedPlan`.
        progress: called with lines on the progress.
        prove: whether the motion is proved, however long it takes.
        sensitivities: the slopes of the objective by the payload and the numbers in [parameters], exact, with the effect of
            one per cent and of a tolerance.

    Raises:
        LinkplanError: if the problem is invalid.

    Example::

        print(linkplan.plan("knee-reach"))
    """
    check_flags(prove=prove, sensitivities=sensitivities)
    say, begun, in_phases = listener(progress), time.process_time(), given_phases(problem)
    if in_phases is not None:
        if prove or sensitivities:
            raise ProblemError("prove and sensitivities take one phase: save the plan and name the folder of a phase in it")
        from linkplan.planner.search.phases import plan_phases
        from linkplan.studies.output.phased_plan import PhasedPlan

        return PhasedPlan.of(plan_phases(in_phases, say))
    asked = given_problem(problem)
    if sensitivities and not asked.mechanism.parameters:
        raise ProblemError(
            "sensitivities are by numbers of the machine: name them in [parameters]; `check` with `parameters` lists them"
        )
    found = plan_motion(asked, say)
    found = with_price(found, price_of(found, say))
    if sensitivities:
        found = with_sensitivities(found, say)
    return Plan.of(_proved(found, prove, begun, say))


def _proved(plan: planned.Plan, asked: bool, begun: float, say: Listener) -> planned.Plan:
    """Return a plan with its proof, if the proof is asked for or takes little of the processor time since `begun` [s].

    A motion that the proof refutes is refined within the rest of the planning time.
    """
    if plan.trajectory is None or not (plan.passed or asked):
        return plan

    def proved(plan: planned.Plan) -> planned.Plan:
        if asked:
            say(PROVING)
            return plan.with_proof()
        until = NO_DEADLINE.within(max(_PROOF_SHARE * (time.process_time() - begun), _PROOF_SECONDS))
        with contextlib.suppress(OutOfTimeError):
            return plan.with_proof(until, existence=False)
        say.keep("proof skipped: it would take longer than a third of the planning; run `linkplan prove` on the saved plan")
        return plan

    if not plan.passed:
        return proved(plan)
    left_s = plan.problem.solver.max_time_s - (time.process_time() - begun)
    return proved_after_refinement(plan, proved, NO_DEADLINE.within(left_s), say)


@command(
    "prove the limits of a plan at every instant, in ball arithmetic, from its saved polynomials",
    showing=("all",),
    without=("anyway",),
)
def prove(plan: PlanLike, *, existence: bool = True, progress: Progress | None = None) -> ProofResult:
    """Return the proof of a plan's limits at every instant, in ball arithmetic, from its polynomials.

    Args:
        plan: with a motion; or its problem, or the name or path of either. A saved motion need not pass its certificate.
        existence: whether to prove, in at most a minute, that the model has a motion near the plan.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion.

    Example::

        print(linkplan.prove("knee-reach", existence=False))
    """
    check_flags(existence=existence)
    say = listener(progress)
    if isinstance(plan, Source | str | Path) and Path(source_of(plan).name).is_dir():
        source = source_of(plan)
        if source.settings:
            raise ProblemError(f"set {source.settings[0]}: a saved plan cannot be changed")
        answer = with_motion(plan_folder.read_to_prove(source.name), "prove")
    else:
        answer = plan_of(plan, say, "prove")
    say(PROVING if existence else "proving the limits")
    return ProofResult(plan=answer, proof=answer.prove(existence=existence))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class ProofResult(Result):
    """The proof of a plan's limits. `str(result)` is the list of claims; `to_dict()` has every one."""

    proof: Proof
    plan: planned.Plan

    @property
    def passed(self) -> bool:
        """Whether no limit is refuted."""
        return self.proof.passed

    def to_dict(self) -> dict:
        """Return the claims that are proved, refuted, undecided or sampled, in JSON types."""
        return {"plan": self.plan.problem.name} | plain_record(self.proof)

    def blocks(self) -> list[Block]:
        """Return the claims as a document."""
        from linkplan.studies.output.document import Text
        from linkplan.studies.output.plan_blocks import names_in, proof_blocks

        return [Text(text=self.plan.problem.name), *proof_blocks(self.proof, names_in(self.plan))]

    def document(self) -> Report:
        """Return the report of the plan with its proof."""
        from linkplan.studies.output.plan_sections import plan_report

        return plan_report(replace(self.plan, proof=self.proof))

    def __repr__(self) -> str:
        return f"ProofResult({self.plan.problem.name!r}: {self.proof.verdict})"


def read_plan(
    folder: str | Path,
    *,
    anyway: bool = False,
    extra_costs: Sequence[ExtraCost] = (),
    extra_limits: Sequence[ExtraLimit] = (),
) -> Plan | PhasedPlan:
    """Return a saved plan, with its problem built again and a new certificate of the saved motion.

    A plan in phases has one of each phase.

    Args:
        folder: of the plan.
        anyway: whether a plan that does not pass its certificate is returned, with status "failed", instead of refused.
        extra_costs: the extra costs of the plan, which files do not contain. Without them the objective is not checked, and
            the plan has a note on it.
        extra_limits: likewise, the limits.

    Raises:
        CertificateError: if the motion does not pass.
        LinkplanError: if the folder or a file in it is missing, truncated, or not that of a plan, or its model has changed.

    Example::

        linkplan.plan("knee-reach").save("reach")
        print(linkplan.read_plan("reach").duration_s)
    """
    check_flags(anyway=anyway)
    folder = path_of(folder, "folder")
    if (folder / PHASES_FILE).is_file():
        from linkplan.studies.output.phased_plan import PhasedPlan

        return PhasedPlan.read(folder)
    answer = plan_folder.read_plan(folder, anyway=anyway, extra_costs=extra_costs, extra_limits=extra_limits)
    note = plan_folder.unchecked(folder)
    if note is not None:
        LOG.warning("%s: %s", folder, note)
    return Plan.of(answer)


class Planner:
    """A planner for many problems that differ in numbers only; each solve starts from the last solution, if possible.

    Payload, start, goal, duration, limits, waypoints, weights and references are such numbers. Mutable: it keeps its last
    program. Threads that share a planner wait for each other. A copied or unpickled planner is new and has no `progress`.

    Args:
        progress: called with lines on the progress.

    Example::

        planner = linkplan.Planner()
        reach = linkplan.Problem.from_file("knee-reach")
        for goal in (56.27, 55.0):
            print(planner.plan(reach.replace(goal_deg={"O": goal})).objective)
    """

    def __init__(self, progress: Progress | None = None) -> None:
        self._planner = Replanner(listener(progress))

    def __reduce__(self) -> tuple:
        return Planner, ()  # solvers and locks cannot be pickled

    def plan(self, problem: Problem | str | Path) -> Plan:
        """Return the plan of a problem like `linkplan.plan`, but faster if the last plan is similar.

        Raises:
            LinkplanError: if the problem is invalid.
        """
        return Plan.of(self._planner.plan(given_problem(problem)))

    def step(self, problem: Problem | str | Path) -> NextMotion | None:
        """Return a motion by a few Newton steps from the last plan, for replanning at the rate of control.

        A step takes a quarter of the time of `plan`, except in the first call. The motion is not certified, but
        has bounds on its error. The next step starts from it. Returns None if the problem differs from the last one in more
        than numbers. It also returns None if the last plan was found without a program, such as a least time along limits on
        power, pin force or speed. Then call `plan`.

        Raises:
            LinkplanError: if the problem is invalid.
        """
        return self._planner.step(given_problem(problem))


class Plan(planned.Plan, Reported):
    """A certified motion, or the reason why there is none. `str(plan)` is its report; `to_dict()` has every value.

    Times are in seconds from the motion's start. This class adds to the planner's `Plan` the members that need files,
    figures and reports, which the planner cannot import.

    Example::

        plan = linkplan.plan("knee-reach").require()
        print(plan.status, plan.objective, plan.sample(0.08).effort["act_O"])  # N.m
    """

    __slots__ = ()

    @classmethod
    def of(cls, plan: planned.Plan) -> Plan:
        """Return the planner's plan as this class."""
        return cls(**{field.name: getattr(plan, field.name) for field in fields(plan)})

    def plot(self, path: str | Path | None = None) -> Figure:
        """Return the figure of positions, speeds and efforts over time, saved at `path` if it is given.

        Raises:
            LinkplanError: if the plan has no motion.
        """
        self.require_motion("draw")
        from linkplan.studies.output.draw_plan import plan_figure

        return drawn(path, lambda: plan_figure(self))

    def save(self, folder: str | Path, *, jumps: bool = False, parquet: bool = False, report: bool = False) -> Path:
        """Write the plan's folder, completely or not at all, and return its path: plan.json, trajectory.npz, .csv, plan.png.

        Args:
            folder: an older plan in it is replaced.
            jumps: whether trajectory.csv has both sides of a jump in effort.
            parquet: whether trajectory.parquet is written too.
            report: whether report.html, an animated page, is written too.

        Raises:
            LinkplanError: if the plan has no motion, the folder has other files, or it cannot be written.
        """
        check_flags(jumps=jumps, parquet=parquet, report=report)
        self.require_motion("save")
        from linkplan.studies.output.draw_plan import save_plan

        target = path_of(folder, "folder")

        def write(place: Path) -> None:
            save_plan(self, place, target, jumps=jumps, parquet=parquet)
            if report:
                self.report(place / "report.html")

        write_whole(target, write)
        return target

    def document(self) -> Report:
        """Return the report as a document."""
        from linkplan.studies.output.plan_sections import plan_report

        return plan_report(self)

    def blocks(self) -> list[Block]:
        """Return the plan as a document's blocks: motion, certificate, proof and price."""
        from linkplan.studies.output.document import Text
        from linkplan.studies.output.plan_blocks import plan_blocks, sensitivity_blocks

        price = saved_price(self)
        more = [] if price is None else [Text(text=price.sentence())]
        return [*plan_blocks(self), *more, *sensitivity_blocks(self)]

    @property
    def struct(self) -> PlanRecord:
        """The record of plan.json; with a reserve or ranges it also has the price of robustness."""
        return structs.replace(plan_folder.record_of(self), price=saved_price(self) or UNSET)
