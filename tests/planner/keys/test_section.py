"""Sections that follow from the fields of a dataclass: one declaration gives the keys, and values by joint in SI."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pytest

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.keys import kinds
from linkplan.planner.problem.keys.key_table import key_table
from linkplan.planner.problem.keys.reading import read
from linkplan.planner.problem.keys.section import KeyOf, section_of
from linkplan.planner.problem.limits import _of_joints


@dataclass
class Values:
    """A limit in degrees on hinges and metres on slides, one in SI, and a number."""

    speed: Annotated[Any, KeyOf("speed_deg_s", "joint", kinds.Speeds, "hinges' speeds", "deg/s")] = None
    momentum: Annotated[Any, KeyOf("momentum", "joint", kinds.Speeds, "momenta by joint", "N.m.s, N.s")] = None
    share: Annotated[float, KeyOf("share", "", kinds.Margin, "a share")] = 0.25


TABLE = section_of(Values, "TableSection", "A table.")


def test_a_section_has_the_keys_of_the_fields_and_the_twin_of_a_key_in_degrees():
    rows = {row.name: row for row in key_table(TABLE)}
    assert list(rows) == ["speed_deg_s", "speed_m_s", "momentum", "share"]
    assert [row.unit for row in rows.values()] == ["deg/s", "m/s", "N.m.s, N.s", ""]
    assert rows["speed_m_s"].doc == "slides' speeds"
    assert rows["momentum"].default_words == "none"
    assert TABLE().share == 0.25


def test_values_by_joint_become_rows_in_si():
    crank = load_mechanism("slider-crank")
    hinge, slide = (next(i for i, joint in enumerate(crank.joints) if joint.kind == kind) for kind in ("hinge", "slide"))
    names = [joint.name for joint in crank.joints]
    given = {
        "speed_deg_s": {names[hinge]: 180.0},
        "speed_m_s": {names[slide]: [-0.5, 2.0]},
        "momentum": {names[hinge]: 3.0},
    }
    found = read(TABLE, given, "table")
    speed, momentum = (_of_joints(found, key, crank) for key in ("speed_deg_s", "momentum"))
    assert speed[hinge] == pytest.approx([-np.pi, np.pi])
    assert speed[slide].tolist() == [-0.5, 2.0]
    assert momentum[hinge].tolist() == [-3.0, 3.0]
    assert np.isinf(momentum[slide]).all()
    with pytest.raises(ProblemError, match="joint 'Z' is not in"):
        _of_joints(TABLE(momentum={"Z": 1.0}), "momentum", crank)
