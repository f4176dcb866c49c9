"""What `linkplan experiment` prints: what trackers make of the machines, and which imperfection they owe it to."""

from linkplan.studies.experiment.experiment_text import experiment_text, tube_said
from linkplan.studies.experiment.sensitivity_text import sensitivity_text
from linkplan.studies.experiment.study import Outcome


def outcome_text(outcome: Outcome) -> str:
    """Return the tables of an outcome; means only of a design whose machines lie as the distributions say."""
    experiment, settings = outcome.experiment, outcome.experiment.settings
    name, found = experiment.plan.problem.name, []
    if outcome.distributed:
        tube, notes = tube_said(experiment), outcome.record["notes"]
        found.append(experiment_text(name, outcome.summary, settings.design, settings.seed, tube, notes))
    if outcome.sensitivity is not None:
        found.append(sensitivity_text(name, outcome.sensitivity, settings.seed))
    return "\n\n".join(found)
