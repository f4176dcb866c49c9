"""Soft closures: the closure gap that `check` reports, against MuJoCo left to itself."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from linkplan.models.catalogue import built_in_text
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.models.poses.along import needed_effort
from linkplan.studies.check.inspection import inspect
from linkplan.studies.check.new.loop_gap import home_gap
from linkplan.studies.check.softness import soft_closures, softness_note
from tests.support.tolerances_loops import SETTLED_SPEED

STIFF = built_in_text("optimus-knee")
SOFT = re.sub(r' solref="[^"]*" solimp="[^"]*"', "", STIFF)
# A heavier rocker, whose weight passes through the pin, and a crank that comes to rest.
HEAVY = SOFT.replace('<geom name="B" class="rocker"', '<geom name="B" class="rocker" mass="0.8"').replace(
    '<joint name="O"', '<joint name="O" damping="0.2"'
)
# MuJoCo's own settled gap beside the law's: the pose gives way with the loop.
SETTLED = 0.03
# A stiff spring that holds the crank, and a run of many time constants of the loop [N.m/rad, s].
KP, RUN_S = 2e3, 0.6


def settled_gap(mechanism: Mechanism, effort: float) -> float:
    """Return the gap [m] at which MuJoCo settles with the crank held at home and a torque on it beside."""
    model = mechanism.model
    data = mujoco.MjData(model)
    home = mechanism.qpos_of(mechanism.home)
    data.qpos[:] = home
    for _ in range(round(RUN_S / model.opt.timestep)):
        data.ctrl[0] = effort - KP * (data.qpos[0] - home[0])
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < SETTLED_SPEED
    return mechanism.gap_m(mechanism.q_of(data.qpos))


def hold(mechanism: Mechanism) -> float:
    still = np.zeros((1, 1))
    return needed_effort(mechanism, mechanism.home[None], still, still)[0].item()


# The second begins at impedance 0, which MuJoCo clips, and gets stiff within a millimetre.
@pytest.mark.parametrize("connect", ["<connect ", '<connect solimp="0 1 0.001 0.5 2" '])
def test_mujoco_settles_with_the_gap_that_is_told_for_the_weight(connect):
    mechanism = load_mechanism(HEAVY.replace("<connect ", connect))
    (soft,) = soft_closures(mechanism, 0.0)
    found = settled_gap(mechanism, hold(mechanism))
    assert found > 1e-4
    assert soft.weight_gap_m == pytest.approx(found, rel=SETTLED)
    assert home_gap(mechanism) * mechanism.extent_m == pytest.approx(found, rel=SETTLED)


def test_check_notes_a_soft_loop_and_what_to_write():
    mechanism = load_mechanism(SOFT)
    (note,) = (note for note in inspect(mechanism, []).notes if "opens by" in note)
    assert note == softness_note(mechanism)
    assert "in MuJoCo loop B opens by" in note
    assert 'mechanism.solref = "stiff" leaves' in note
    assert "act_O at its limit" in note


def test_a_stiff_loop_is_not_noted():
    assert softness_note(load_mechanism(STIFF)) is None


def test_a_model_without_a_connect_or_weld_has_nothing_soft():
    assert soft_closures(load_mechanism("cart-pole"), 0.0) == ()


def test_a_gap_that_is_as_wide_as_the_mechanism_is_not_given_in_millimetres():
    mechanism = load_mechanism(SOFT)
    strong = replace(mechanism, actuators=(replace(mechanism.actuators[0], lower=-1e4, upper=1e4),))
    note = softness_note(strong)
    assert note is not None
    assert f"more than {10 * mechanism.extent_m:.2g} mm with act_O at its limit" in note
