"""The text output of `linkplan experiment`: the trackers' results, and the influence of the imperfections."""

from linkplan.studies.experiment.experiment_text import experiment_text, tube_text
from linkplan.studies.experiment.sensitivity_text import sensitivity_text
from linkplan.studies.experiment.study import Outcome


def outcome_text(outcome: Outcome) -> str:
    """Return the tables of an outcome; means only if the machines are distributed like the imperfections."""
    experiment, settings = outcome.experiment, outcome.experiment.settings
    name, found = experiment.plan.problem.name, []
    if outcome.distributed:
        tube, notes = tube_text(experiment), outcome.record["notes"]
        found.append(experiment_text(name, outcome.summary, settings.design, settings.seed, tube, notes))
    if outcome.sensitivity is not None:
        found.append(sensitivity_text(name, outcome.sensitivity, settings.seed))
    return "\n\n".join(found)
