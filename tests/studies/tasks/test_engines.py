"""Engines: every task once, refusals in words, workers that die; sites that workers have in common."""

import concurrent.futures
import contextlib
import gc
import itertools
import os
import signal
import sys
from pathlib import Path

import pytest

from linkplan.models.errors import LinkplanError, ProblemError
from linkplan.planner.files.folders import write_json, write_whole
from linkplan.planner.plan.folder import versions
from linkplan.planner.search.planning import silent
from linkplan.studies.variations.batch.study import run_batch
from linkplan.studies.variations.experiment.experiment import Settings
from linkplan.studies.variations.experiment.study import RECORD, RESULTS, run_experiment
from linkplan.studies.variations.tasks import cluster as dask_cluster
from linkplan.studies.variations.tasks import streaming
from linkplan.studies.variations.tasks.cluster import cluster
from linkplan.studies.variations.tasks.engine import Pool, processes, serial
from linkplan.studies.variations.tasks.streaming import Refused, StreamProgress, at_site, complete, streamed
from linkplan.studies.variations.tasks.unfinished import PLAN, part, remove, remove_left, working
from tests.support.batches import same_plans, swept
from tests.support.plans import optimal


def squared(task, threads):
    assert threads > 0
    return task * task


def refused(task, threads):
    del threads
    raise ProblemError(f"task {task} makes no sense")


def killed(task, threads):
    del task, threads
    os.kill(os.getpid(), signal.SIGKILL)


def test_where_no_processes_can_be_begun_this_one_runs_every_task(monkeypatch):
    def failing(**_):
        raise OSError(30, "Read-only file system")  # locks between processes need a place such as /dev/shm

    monkeypatch.setattr(concurrent.futures, "ProcessPoolExecutor", failing)
    said = []
    assert dict(streamed(processes(2), squared, [1, 2, 3], said.append)) == {1: 1, 2: 4, 3: 9}
    assert "Read-only file system" in " ".join(said)


def test_this_process_runs_each_task_when_the_one_before_is_taken():
    ran = []

    def work(task, threads):
        ran.append(task)
        return squared(task, threads)

    results = streamed(serial, work, [3, 1, 2], silent)
    assert next(results) == (3, 9)
    assert ran == [3]
    assert list(results) == [(1, 1), (2, 4)]


@pytest.mark.parametrize("tasks", [[], [7], range(40)])
def test_another_engine_can_stand_in_its_place(tasks):
    """Any executor of `concurrent.futures` will do."""

    @contextlib.contextmanager
    def threads(n, say):
        del n, say
        with concurrent.futures.ThreadPoolExecutor(2) as executor:
            yield Pool(executor=executor, ahead=5, threads=1)

    assert dict(streamed(threads, squared, tasks, silent)) == {task: task**2 for task in tasks}


def test_what_a_task_is_refused_with_is_one_line_here():
    with pytest.raises(LinkplanError, match=r"^task 4 makes no sense$"):
        list(streamed(serial, refused, [4], silent))


@pytest.mark.slow
def test_workers_that_die_again_and_again_end_it_in_one_line(monkeypatch):
    monkeypatch.setattr(streaming, "_MOST_DEATHS", 1)
    said = []
    with pytest.raises(LinkplanError, match=r"workers were lost 2 times; finished parts are kept") as error:
        list(streamed(processes(2), killed, [0, 1], said.append))
    assert said == ["a worker was lost; its task runs again"]
    assert "\n" not in str(error.value)


def test_a_worker_with_other_versions_is_refused():
    answer = at_site(os.getcwd(), {**versions(), "mujoco": "9.9"}, squared, 2, 1)
    assert isinstance(answer, Refused)
    assert "here 9.9; install the same version there" in answer.text


def test_a_task_runs_in_the_folder_of_who_asks(tmp_path, monkeypatch):
    before = os.getcwd()
    assert at_site(str(tmp_path), {}, os.getcwd) == str(tmp_path)
    assert os.getcwd() == before
    answer = at_site(str(tmp_path / "nowhere"), {}, os.getcwd)
    assert isinstance(answer, Refused)
    assert "does not see" in answer.text
    monkeypatch.undo()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://x", "", "127.0.0.1", "tcp://127.0.0.1:many"])
def test_an_address_at_which_no_scheduler_answers_is_refused_in_one_line(address, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(dask_cluster, "_PATIENCE_S", 0.2)
    with pytest.raises(LinkplanError, match=f"no Dask scheduler answers at '{address}'") as refusal:
        list(streamed(cluster(address), squared, [1], silent))
    assert "\n" not in str(refusal.value)


def test_a_client_that_was_refused_leaves_nothing_to_be_collected_while_the_next_one_begins():
    distributed = pytest.importorskip("distributed")
    gc.collect()
    gc.disable()  # the collector runs only where it is asked to
    try:
        before = clients(distributed)
        with pytest.raises(LinkplanError):
            list(streamed(cluster("nonsense://x"), squared, [1], silent))
        after = clients(distributed)
    finally:
        gc.enable()
    assert all(client in before for client in after)


def clients(distributed):
    return [kept for kept in gc.get_objects() if type(kept) is distributed.Client]


def test_progress_counts_and_says_what_was_done_before():
    said = []
    progress = StreamProgress(10, 4, "samples", said.append)
    progress.more(3)
    progress.more(3)
    assert said[0] == "4 of 10 samples are already finished"
    assert said[1].startswith("7 of 10 samples, about 0 s left")
    assert said[2] == "10 of 10 samples"


def test_an_interrupt_while_workers_are_waited_for_reaches_the_command(tmp_path, monkeypatch):
    """A signal between two results, and its repetition while the engine closes: neither is lost in a destructor."""

    @contextlib.contextmanager
    def waiting(n, say):
        try:
            with serial(n, say) as pool:
                yield pool
        finally:
            raise KeyboardInterrupt("again")

    def interrupted(*_):
        raise KeyboardInterrupt("first")

    lost = []
    monkeypatch.setattr(sys, "unraisablehook", lost.append)
    with pytest.raises(KeyboardInterrupt, match="again"):
        complete(tmp_path, [range(1), range(1, 2)], "cases", waiting, lambda *_: [], interrupted, silent)
    gc.collect()
    assert not lost


REQUEST = {"format": 1}


class KilledError(BaseException):
    """What no handler of the program catches, as a kill."""


def folder_of_parts(place: Path) -> Path:
    folder = place / "out.unfinished"
    with working(folder, REQUEST, "a test"):
        write_whole(folder / PLAN, lambda new: write_json(new / "plan.json", {}))
        part(folder, 0, "json").write_text("{}", encoding="utf-8")
    return folder


@pytest.mark.parametrize("kind", ["unlink", "rmdir"])
def test_parts_whose_removal_was_killed_anywhere_are_removed_by_the_next_run(kind, tmp_path, monkeypatch):
    kills = 0
    for step in itertools.count():
        folder = folder_of_parts(tmp_path)
        counter, real = itertools.count(), getattr(os, kind)

        def stopped(path, *given, counter=counter, real=real, step=step, **more):
            if next(counter) == step:
                raise KilledError
            return real(path, *given, **more)

        with monkeypatch.context() as patch:
            patch.setattr(os, kind, stopped)
            try:
                remove(folder)
            except KilledError:
                kills += 1
            else:
                break
        remove_left(folder, REQUEST)
        assert not folder.exists(), f"killed at {kind} {step}"
    assert kills >= 3


distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

SHORT = "tracking.duration_s=0.005"
# Three whole blocks and a beginning.
SETTINGS = Settings(trackers=("pd",), samples=3 * 128 + 8)


@pytest.fixture(scope="module")
def two_workers():
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as workers:
        yield workers


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The files of an experiment that one process has made."""
    return studied(tmp_path_factory.mktemp("alone") / "x", serial)


def studied(target, engine, say=silent):
    plan = optimal("knee-reach", SHORT)
    run_experiment({"name": "knee-reach"}, None, lambda: plan, SETTINGS, target, say, engine=engine)
    return {name: (target / name).read_bytes() for name in (RESULTS, RECORD)}


def test_a_cluster_makes_the_file_of_one_process(tmp_path, two_workers, alone):
    assert studied(tmp_path / "x", cluster(two_workers.scheduler_address)) == alone


def test_a_worker_that_is_killed_in_the_middle_loses_nothing(tmp_path, two_workers, alone):
    killed, said = [], []

    def say(text):
        said.append(text)
        if not killed and " samples" in text:
            killed.append(next(iter(two_workers.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    assert studied(tmp_path / "x", cluster(two_workers.scheduler_address), say) == alone
    assert killed
    assert len([text for text in said if " samples" in text]) == 4  # no block twice


def test_a_batch_on_a_cluster_has_the_plans_of_one_process(tmp_path, two_workers):
    batch = swept(9)
    run_batch(batch, tmp_path / "x", silent)
    run_batch(batch, tmp_path / "y", silent, engine=cluster(two_workers.scheduler_address))
    same_plans(tmp_path / "x", tmp_path / "y", 9)


def refusing(task, threads):
    raise LinkplanError(f"no sample of task {task} can be run on {threads} threads")


def test_what_a_worker_refuses_is_refused_here_in_its_words(two_workers):
    with pytest.raises(LinkplanError, match="no sample of task 5 can be run on 1 threads"):
        list(streamed(cluster(two_workers.scheduler_address), refusing, [5], silent))
