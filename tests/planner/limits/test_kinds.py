"""The table of kinds of limits: program, certificate and diagnosis loop over it. A kind that is not in it limits nothing."""

from linkplan.planner.limits.joints import RangeLimit
from linkplan.planner.limits.kinds import KINDS, RELAXED
from linkplan.planner.limits.path_limit import PathLimit


def test_every_kind_of_limit_is_in_the_table():
    assert {kind.__name__ for kind in PathLimit.__subclasses__()} == {kind.__name__ for kind in KINDS}


def test_the_diagnosis_may_take_every_kind_away_but_ranges_which_it_takes_last():
    assert set(RELAXED) == set(KINDS) - {RangeLimit}
    assert len(RELAXED) == len(KINDS) - 1


def test_no_two_kinds_have_one_key():
    assert len({kind.key for kind in KINDS}) == len(KINDS)
