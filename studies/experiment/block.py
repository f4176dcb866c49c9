"""The unit of work of an experiment: a block of samples with every tracker, as columns."""

from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.simulate import bytes_each, simulate
from linkplan.studies.experiment.experiment import Experiment
from linkplan.studies.experiment.laws import law_of
from linkplan.studies.experiment.metrics import measured, metrics_of, within_tube

# Samples of a block: a worker computes one block at a time, and an interruption loses at most one block.
BLOCK_SAMPLES = 128
# Largest log of simulations that are stepped together.
_MAX_LOG_BYTES = 256 << 20


def block_count(n: int) -> int:
    """Return the number of blocks of n samples."""
    return -(-n // BLOCK_SAMPLES)


def samples_of(block: int, n: int) -> range:
    """Return the samples of a block."""
    return range(block * BLOCK_SAMPLES, min(n, (block + 1) * BLOCK_SAMPLES))


def run_block(experiment: Experiment, block: int, threads: int = 0, batch: int | None = None) -> dict[str, list]:
    """Return the results of a block as columns of equal length, ordered by sample and then by tracker.

    Args:
        experiment: the experiment.
        block: index of the block.
        threads: simulator threads; 0 for one per core.
        batch: most simulations stepped together; results do not depend on it.
    """
    samples = samples_of(block, experiment.n)
    mechanism, reference = experiment.plan.problem.mechanism, experiment.reference
    together = max(1, min(batch or BLOCK_SAMPLES, _MAX_LOG_BYTES // bytes_each(mechanism, reference.n)))
    found: dict[tuple[int, str], dict] = {}
    plant = MujocoPlant(mechanism=mechanism, loop=experiment.loop, threads=threads)
    laws = {name: law_of(name, experiment) for name in experiment.settings.trackers}
    for first in range(samples.start, samples.stop, together):
        part = range(first, min(samples.stop, first + together))
        machines = [experiment.machine(sample) for sample in part]  # built once, for all trackers
        for name, law in laws.items():
            ensemble = simulate(plant, law, reference, machines)
            for i, sample in enumerate(part):
                found[sample, name] = {
                    "success": within_tube(ensemble, i, experiment.yardstick),
                    "failure": ensemble.failure[i],
                    **measured(ensemble, i, experiment.yardstick),
                }
    keys = [(sample, name) for sample in samples for name in experiment.settings.trackers]
    columns: dict[str, list] = {"sample": [key[0] for key in keys], "tracker": [key[1] for key in keys]}
    for name in ("success", "failure", *metrics_of(mechanism)):
        columns[name] = [found[key][name] for key in keys]
    for name, values in experiment.varied_values().items():
        columns[name] = [float(values[key[0]]) for key in keys]
    return columns
