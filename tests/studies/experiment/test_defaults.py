"""The imperfections of a careful build: sizes are the machine's, whatever a plan leaves to feedback."""

from linkplan.studies.variations.experiment.experiment import default_imperfections
from tests.support.plans import optimal


def test_a_plan_s_reserve_does_not_make_the_machine_s_imperfections_smaller():
    whole, kept = optimal("knee-sprint"), optimal("knee-sprint", "limits.reserve=0.1")
    assert kept.certificate.peak_effort[0] < 0.95 * whole.certificate.peak_effort[0]
    assert default_imperfections(kept) == default_imperfections(whole)
    assert default_imperfections(kept)["coulomb_friction"] == {"O": [0.0, 2.0]}
