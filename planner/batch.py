"""Many problems that vary one, planned one after the other, warm where they differ in numbers alone."""

from collections.abc import Iterator

from linkplan.models.errors import ProblemError
from linkplan.planner.files.batch_file import Batch, Case
from linkplan.planner.files.problem_file import problem_from_tables
from linkplan.planner.files.tables import apply_override, read_tables
from linkplan.planner.plan import Plan
from linkplan.planner.refinement.history import Say, silent
from linkplan.planner.replan import Planner


def plan_batch(batch: Batch, say: Say = silent) -> Iterator[tuple[Case, Plan]]:
    """Yield each case with its plan, in order; what differs in numbers alone is solved from the last solution.

    Raises:
        ProblemError: for a case whose settings cannot be used, naming it, before any is planned.
        ModelError: when a mechanism that is named cannot be used.
    """
    problems = []
    for case in batch.cases:
        name, tables, folder = read_tables(batch.problem)
        try:
            for setting in (*batch.common, *case.settings):
                apply_override(tables, setting)
            problems.append(problem_from_tables(f"{name}/{case.name}", tables, folder))
        except ProblemError as error:
            raise ProblemError(f"case '{case.name}': {error}") from error
    planner = Planner()
    for number, (case, problem) in enumerate(zip(batch.cases, problems, strict=True)):
        say(f"{number + 1} of {len(problems)}: {case.name}")
        yield case, planner.plan(problem)
