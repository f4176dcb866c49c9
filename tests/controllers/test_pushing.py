"""The mean of a push over the simulator's steps."""

import numpy as np

from linkplan.controllers.imperfections.batch_effects import PushState

FORCE, EFFORT = 8.0, -3.0


def test_a_push_acts_on_its_share_of_every_step_and_its_impulse_is_whole():
    start, end = 1.25, 3.5
    push = PushState(
        start=np.array([[start]]),
        end=np.array([[end]]),
        force=np.full((1, 1, 1, 6), FORCE),
        effort=np.full((1, 1, 1), EFFORT),
    )
    forces, efforts = (np.array(values) for values in zip(*map(push.over, range(5)), strict=True))
    np.testing.assert_allclose(forces[:, 0, 0, 0] / FORCE, [0.0, 0.75, 1.0, 0.5, 0.0])
    np.testing.assert_allclose(efforts[:, 0, 0] / EFFORT, [0.0, 0.75, 1.0, 0.5, 0.0])
