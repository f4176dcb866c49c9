"""`experiment` and `decompose`: metrics of runs on thousands of machines, and the causes of each tracker's error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from msgspec import structs

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, listed, plan_of, problem_of
from linkplan.api.names import LINEAR, Design
from linkplan.api.reporting import Progress, listener
from linkplan.api.typed_commands import sample_again
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.settings import whole
from linkplan.studies.compare.user_tracker import TrackerLike, name_of, refuse_unpicklable, trackers_loaded
from linkplan.studies.output.paths import path_of
from linkplan.studies.variations.decompose import decompose as study
from linkplan.studies.variations.decompose.decomposition import Decomposition
from linkplan.studies.variations.experiment.experiment import Settings, plan_digest
from linkplan.studies.variations.experiment.experiment_blocks import ExperimentOutcome
from linkplan.studies.variations.experiment.study import run_experiment
from linkplan.studies.variations.tasks.cluster import engine_of


@command("run every tracker on the same set of imperfect machines", showing=("report",))
def experiment(
    plan: PlanLike,
    trackers: Sequence[TrackerLike] = LINEAR,
    *,
    samples: int = 200,
    imperfections: Mapping | None = None,
    seed: int = 0,
    design: Design = "latin-hypercube",
    levels: int = 3,
    tube_deg: float = 1.0,
    tube_m: float = 0.01,
    folder: str | Path | None = None,
    workers: int = 1,
    cluster: str | None = None,
    threads: int = 0,
    progress: Progress | None = None,
) -> ExperimentOutcome:
    """Return trackers' metrics on many imperfect machines in MuJoCo, with 95 % confidence intervals.

    Args:
        plan: a plan with a motion; a problem, which is planned if results are missing; or the name or path of either.
        trackers: built-in names, or your own trackers: objects, classes or functions as for `track`, "module:object", or a
            name that an installed package defines. In the results, an object has the name "own:" plus its own name. With
            several workers an object must be picklable.
        samples: number of machines; for a grid, the levels determine it.
        imperfections: the table [imperfections] of a problem file; by default that of the problem or, without one, the
            default table (docs/experiments.md).
        seed: seed of all random numbers.
        design: "latin-hypercube" or "grid".
        levels: values of each random imperfection in a grid.
        tube_deg: a run succeeds if every hinge stays within this angle of the path.
        tube_m: likewise, for slides.
        folder: the folder for the results, written completely or not at all. Finished parts are kept next to it, and the
            same call continues from them.
        workers: number of processes on this machine. More than one needs
            `if __name__ == "__main__":` in the caller's module.
        cluster: the address of a Dask scheduler, such as tcp://head:8786, whose workers share the work.
        threads: threads of the simulator for each worker; 0 for an equal share of the cores.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, an argument is invalid, or the folder has other files.

    Example::

        print(linkplan.experiment(linkplan.plan("knee-reach"), ["pd+ff"], samples=8))
    """
    say = listener(progress)
    listed(trackers, "names, objects, classes or functions")
    own = {name_of(one): one for one in trackers if not isinstance(one, str)}
    names = tuple(one if isinstance(one, str) else name_of(one) for one in trackers)
    engine = engine_of(workers, cluster)
    whole(threads, "threads", 0, 10_000)
    if own and (workers > 1 or cluster is not None):
        refuse_unpicklable(own)
    settings = Settings(
        trackers=names,
        samples=samples,
        seed=seed,
        design=design,
        levels=levels,
        tube_deg=tube_deg,
        tube_m=tube_m,
    )
    target = None if folder is None else path_of(folder, "folder")
    problem, answer = problem_of(plan), None
    if problem is None:
        answer = plan_of(plan, say, "track")
        problem = answer.problem
    if imperfections is not None:
        problem = problem.replace(imperfections=imperfections)
    source: dict = {"name": problem.name, **problem.to_dict()}
    digest = None
    if answer is None:
        source["model_hash"] = problem.mechanism.fingerprint()
    else:
        answer = replace(answer, problem=problem)
        digest = plan_digest(answer)

    def made() -> Plan:
        return plan_of(problem, say, "track") if answer is None else answer

    outcome = run_experiment(source, digest, made, settings, target, say, engine=engine, threads=threads, own=own)
    return outcome if target is None else structs.replace(outcome, folder=target, again=partial(sample_again, target))


@command(
    "split each tracker's error among its causes: plan, sampling and delay, simulator, devices, model, limits",
    saved=True,
    showing=("report",),
)
def decompose(
    plan: PlanLike,
    trackers: Sequence[TrackerLike] = LINEAR,
    *,
    imperfections: Mapping | None = None,
    samples: int = 16,
    seed: int = 0,
    progress: Progress | None = None,
) -> Decomposition:
    """Return each tracker's rms error on a plan, split among its causes: signed parts whose sum is the error.

    Starting from an ideal loop, the effects of a real loop are switched on one by one: discretisation of the plan, the
    feedforward that the tracker lacks, sampling and delay, the simulator, sensors and drives, model error, effort limits
    (docs/choose-a-tracker.md).

    Args:
        plan: a plan with a motion, a problem, or the name or path of either.
        trackers: built-in names, or functions of the sampled reference that return a law.
        imperfections: the table [imperfections] of a problem file; by default that of the problem or, without one, the
            default table (docs/experiments.md).
        samples: number of random machines; there is a single one if nothing is random.
        seed: seed of all random numbers.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the plan has no motion, or an argument is invalid.

    Example::

        print(linkplan.decompose(linkplan.plan("knee-reach"), ["pd"], imperfections={"payload_mass_factor": 1.2}))
    """
    say = listener(progress)
    asked = trackers_loaded(listed(trackers, "names or functions"))
    whole(seed, "seed", 0, 2**63 - 1)
    answer = plan_of(plan, say, "track")
    if imperfections is not None:
        answer = replace(answer, problem=answer.problem.replace(imperfections=imperfections))
    return study.decompose(answer, asked, samples, seed, say)
