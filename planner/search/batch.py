"""Planning of many variations of a problem in turn, with warm starts if only numbers differ."""

import copy
import hashlib
from collections.abc import Iterator, Sequence

from linkplan.models.deadline import check
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import apply_override, read_tables
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.keys.sections import BatchFile, CaseSection
from linkplan.planner.problem.phases import PhasedProblem
from linkplan.planner.problem.problem import Problem
from linkplan.planner.refinement.history import Say, silent
from linkplan.planner.search.replan import Replanner


def check_batch(batch: BatchFile) -> str:
    """Check every case of a batch, and return the hash of everything that its plans depend on.

    Raises:
        ProblemError: for a case whose settings cannot be used, naming it.
        ModelError: when a named mechanism cannot be used.
    """
    digest, last = hashlib.sha256(), None
    # Ten thousand problems take gigabytes, so each is built, checked, discarded, and later built again for planning.
    for case, problem in _problems(batch, batch.case):
        check()
        if isinstance(problem, PhasedProblem):
            from linkplan.planner.search.phase_poses import phase_poses

            try:
                mechanism = phase_poses(problem).bare[0]  # raises for contacts and joints that no pose has
            except ProblemError as error:
                raise ProblemError(f"case '{case.name}': {error}") from error
        else:
            mechanism = problem.mechanism
        if mechanism is not last:
            digest.update(mechanism.fingerprint().encode())
            last = mechanism
        digest.update(f"{case.name}: {problem.to_dict()!r}\n".encode())
    return digest.hexdigest()


def plan_cases(
    batch: BatchFile, cases: Sequence[CaseSection], say: Say = silent
) -> Iterator[tuple[CaseSection, Plan | PhasedRecord]]:
    """Yield the cases of a batch with their plans, in order; if only numbers differ, the last solution is the start.

    Motions in phases are each planned from the beginning.

    Raises:
        ProblemError: for a case whose settings cannot be used, naming it.
        ModelError: when a named mechanism cannot be used.
    """
    planner = Replanner()
    for case, problem in _problems(batch, cases):
        say(case.name)
        if isinstance(problem, Problem):
            yield case, planner.plan(problem)
            continue
        from linkplan.planner.search.phases import plan_phases

        yield case, plan_phases(problem)


def _problems(batch: BatchFile, cases: Sequence[CaseSection]) -> Iterator[tuple[CaseSection, Problem | PhasedProblem]]:
    """Yield each case with its problem; consecutive cases with equal [mechanism] tables share one mechanism."""
    name, common, folder = read_tables(batch.problem)
    asked: object = None
    mechanism: Mechanism | None = None
    for case in cases:
        tables = copy.deepcopy(common)
        try:
            for setting in (*batch.set, *case.set):
                apply_override(tables, setting)
            if "phases" in tables:
                yield case, PhasedProblem.from_tables(f"{name}/{case.name}", tables, folder)
                continue
            wanted = copy.deepcopy(tables.get("mechanism"))
            # Coordinates chosen for one case's motion do not apply to the next case.
            chosen = mechanism is not None and "independent" in mechanism.source and "independent" not in (wanted or {})
            same = mechanism is not None and wanted == asked and not chosen
            problem = Problem.from_tables(f"{name}/{case.name}", tables, folder, mechanism if same else None)
            problem.start_pose()  # raises for a goal beyond reach before any case is planned
        except ProblemError as error:
            raise ProblemError(f"case '{case.name}': {error}") from error
        asked, mechanism = wanted, problem.mechanism
        yield case, problem
