"""A sample of random linkages, planned and judged by answers that are not linkplan's; and those answers by one another."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.bench.random_linkages import drawn_slider, judged
from tests.support.driven_five_bar import random_five_bar
from tests.support.linkage_problems import drawn
from tests.support.mujoco_curves import closed_poses, curves_of_poses
from tests.support.open_linkages import KINDS, random_linkage

SEED = 1
# Of each family one, and one of each thing asked; 38's switch times have further to go than its first mesh lets them.
SAMPLE, SLIDERS = (0, 6, 12, 38, 4), (0, 1, 2, 3, 6)
# Torques by two routes, relative: rounding through a closed loop.
TWO_ROUTES = 1e-9
# Places that MuJoCo's own constraint keeps against the curves', as a share of the motion: what its softness gives way.
SOFT = 2e-3


@pytest.mark.slow
@pytest.mark.parametrize(("draw", "number"), [*((drawn, k) for k in SAMPLE), *((drawn_slider, k) for k in SLIDERS)])
def test_a_random_linkage_s_answer_is_exact(draw, number):
    said, error, _ = judged(draw(SEED, number))
    assert said == "right", f"{error:+.1e} {said}"


@pytest.mark.parametrize("kind", KINDS)
def test_curves_along_poses_move_as_mujoco_s_simulation_does(kind):
    rng = np.random.default_rng([SEED, KINDS.index(kind)])
    while True:
        linkage = random_linkage(rng, kind)
        model = mujoco.MjModel.from_xml_string(linkage.mjcf)
        poses = closed_poses(model, -0.5, 0.5)
        if poses is not None and poses.clear.min() > 0.5:
            break
    curves = curves_of_poses(model, poses)
    u = 2.0 * float(np.abs(curves.still(0.0))) / linkage.gear
    within = 0.2 * float(np.sqrt(curves.inertia(0.0) / np.abs(curves.still(0.0))))

    def rates(_t: float, y: np.ndarray) -> list[float]:
        s, v = y
        return [v, (curves.still(s) + curves.square(s) * v**2 + curves.linear(s) * v + linkage.gear * u) / curves.inertia(s)]

    found = solve_ivp(rates, (0.0, within), [0.0, 0.0], rtol=1e-9, atol=1e-12)
    model.opt.timestep = within / 2000
    model.eq_solref[:] = [2.5 * model.opt.timestep, 1.0]
    data = mujoco.MjData(model)
    data.ctrl[:] = u
    mujoco.mj_step(model, data, 2000)
    assert abs(found.y[0, -1]) > 0.005
    assert data.qpos[0] == pytest.approx(found.y[0, -1], rel=SOFT)


@pytest.mark.parametrize("seed", range(4))
def test_a_five_bar_s_torques_in_closed_form_are_mujoco_s(seed):
    """By the principle of d'Alembert, over all joints."""
    rng = np.random.default_rng(seed)
    bar, _, _ = random_five_bar(rng)
    s, v, a = (scale * rng.normal(size=(1, 2)) for scale in (0.1, 1.0, 1.0))
    model = mujoco.MjModel.from_xml_string(bar.mjcf())
    q, slope, rate, bend = bar.joints(s, v, a)
    data, full = mujoco.MjData(model), np.empty((4, 4))
    data.qpos[:], data.qvel[:] = q, rate
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    assert np.linalg.norm(data.site("P").xpos - data.site("P2").xpos) < 1e-12
    forces = full @ bend + data.qfrc_bias - data.qfrc_passive
    assert bar.efforts(s, v, a)[0][0] == pytest.approx(slope.T @ forces, rel=TWO_ROUTES)
