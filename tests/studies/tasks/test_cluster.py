"""A Dask cluster of two workers runs a study: the file of one process, whoever of them is killed."""

import os
import signal

import pytest

from linkplan.models.errors import LinkplanError
from linkplan.planner.search.planning import silent
from linkplan.studies.variations.batch.study import run_batch
from linkplan.studies.variations.experiment.experiment import Settings
from linkplan.studies.variations.experiment.study import RECORD, RESULTS, run_experiment
from linkplan.studies.variations.tasks.cluster import cluster
from linkplan.studies.variations.tasks.engine import serial
from linkplan.studies.variations.tasks.streaming import streamed
from tests.support.batches import same_plans, swept
from tests.support.plans import optimal

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
