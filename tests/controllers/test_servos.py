"""The ctrl that gives a servo's effort: force = (g0 + g1 l + g2 l') ctrl + b0 + b1 l + b2 l' (MuJoCo, "Actuation")."""

import numpy as np
import pytest

from linkplan.controllers.imperfections.servos import ServoInversion

GAINS, BIASES = np.array([3.0, 0.5, -0.4]), np.array([0.2, -2.0, -0.7])
LENGTH, RATE = 0.6, 1.5


def of_state(coefficients: np.ndarray) -> float:
    return float(coefficients @ [1.0, LENGTH, RATE])


def controls(effort: float, *, motor: bool = False) -> tuple[float, float]:
    servo = ServoInversion(
        gains=GAINS[None], biases=BIASES[None], low=np.array([-1.0]), high=np.array([1.5]), motor=np.array([motor])
    )
    ctrl, given = servo.controls(np.array([[effort]]), np.array([[LENGTH]]), np.array([[RATE]]))
    return float(ctrl[0, 0]), float(given[0, 0])


@pytest.mark.parametrize("ctrl", [-0.9, 0.0, 1.4])
def test_within_its_range_the_ctrl_gives_the_effort(ctrl):
    effort = of_state(GAINS) * ctrl + of_state(BIASES)
    assert controls(effort) == (pytest.approx(ctrl, abs=1e-12), effort)


@pytest.mark.parametrize(("excess", "end"), [(10.0, 1.5), (-10.0, -1.0)])
def test_beyond_its_range_the_effort_is_that_of_the_range_s_end(excess, end):
    given = of_state(GAINS) * end + of_state(BIASES)
    assert controls(given + excess) == (end, pytest.approx(given))
    assert controls(given + excess, motor=True) == (pytest.approx(given), pytest.approx(given))


@pytest.mark.parametrize(("share", "steers"), [(5e-9, True), (5e-10, False)])
def test_a_gain_below_a_billionth_of_its_own_at_home_counts_as_none(share, steers):
    """The gain g0 (1 - l) vanishes at a length of one, where no ctrl changes the effort."""
    servo = ServoInversion(
        gains=np.array([[3.0, -3.0, 0.0]]), biases=np.array([[0.2, -2.0, 0.0]]),
        low=np.array([-np.inf]), high=np.array([np.inf]), motor=np.array([False]),
    )  # fmt: skip
    length = 1.0 - share
    bias = 0.2 - 2.0 * length
    ctrl, given = servo.controls(np.array([[bias + 3.0 * share]]), np.array([[length]]), np.zeros((1, 1)))
    assert ctrl[0, 0] == pytest.approx(1.0 if steers else 0.0, rel=1e-5)
    assert given[0, 0] == (bias + 3.0 * share if steers else pytest.approx(bias, abs=1e-12))
