"""Imperfections: each does to a machine what its unit says, and nothing else."""

import copy

import mujoco
import numpy as np
import pytest
from mujoco.batch import MODEL_FIELDS

from linkplan.controllers.imperfections.batch_effects import FIELDS
from linkplan.controllers.imperfections.driving import act, driving, take
from linkplan.controllers.imperfections.imperfections import Drives, Imperfections, Machine, Sensors, Start
from linkplan.controllers.imperfections.plant import plant
from linkplan.controllers.imperfections.sensing import measure, sensing
from linkplan.controllers.rollout import ControlLoop
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import load_mechanism
from tests.support.machines import LOOP, everything, reach
from tests.support.references import hinge_reference

LIMIT = np.array([[-10.0, 10.0]])
H = 1e-3


def acted(drives: Drives, commands: list[float], delay: float = 0.0, substeps: int = 1) -> np.ndarray:
    """Return the mean efforts of every simulator step under commands, one a period."""
    now = driving([drives], [delay], [H / substeps], substeps, LIMIT)
    efforts = []
    for k, command in enumerate(commands):
        take(now, k, np.array([[command]]))
        for j in range(substeps):
            efforts.append(act(now, k, j)[0, 0])
    return np.array(efforts)


# Drives.


@pytest.mark.parametrize(("delay", "substeps"), [(0.25, 1), (1.75, 1), (0.3, 5), (2.0, 1)])
def test_a_delay_of_any_fraction_moves_an_impulse_by_its_time(delay, substeps):
    commands = [0.0, 0.0, 6.0] + 6 * [0.0]
    efforts = acted(Drives(), commands, delay, substeps)
    middles = (np.arange(len(efforts)) + 0.5) / substeps
    assert efforts.sum() / substeps == pytest.approx(6.0)
    assert (middles * efforts).sum() / efforts.sum() == pytest.approx(2.5 + delay)


# Sensors.


def read(sensors: Sensors, positions: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    now = sensing([sensors], positions[:1, None], np.array([[rate]]), H)
    found = []
    for k, position in enumerate(positions):
        s, v = measure(now, k, np.array([[position]]), np.array([[rate]]))
        found.append((s[0, 0], v[0, 0]))
    return tuple(np.array(found).T)


def test_noise_has_its_standard_deviation_and_comes_from_its_own_seed():
    positions = np.zeros(4000)
    first, rate = read(Sensors(noise=0.02, velocity_noise=0.5, noise_seed=(1, 2)), positions, 0.0)
    other, _ = read(Sensors(noise=0.02, noise_seed=(1, 3)), positions, 0.0)
    assert np.std(first) == pytest.approx(0.02, rel=0.05)
    assert np.std(rate) == pytest.approx(0.5, rel=0.05)
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.05
    assert abs(np.corrcoef(first[1:], first[:-1])[0, 1]) < 0.05


# The plant.


def test_only_listed_fields_of_a_model_are_changed_and_the_mechanism_s_own_model_is_not():
    mechanism, reference = reach()
    before = copy.deepcopy(mechanism.model)
    base = plant(mechanism, reference, LOOP, Imperfections(), 1).model
    changed = set()
    for seed in range(3):
        model = plant(mechanism, reference, LOOP, everything(seed), 1).model
        named = [name for name in MODEL_FIELDS if "." not in name and hasattr(model, name)]
        changed |= {name for name in named if not np.array_equal(getattr(model, name), getattr(base, name))}
    assert {"body_mass", "dof_damping", "eq_solref", "site_pos"} <= changed
    assert changed <= set(FIELDS)
    assert np.array_equal(before.body_mass, mechanism.model.body_mass)
    assert np.array_equal(before.dof_damping, mechanism.model.dof_damping)


def test_a_longer_link_is_longer_and_the_loop_is_closed_with_it():
    mechanism, reference = reach()
    longer = Imperfections(machine=Machine(length_factor={"coupler": 1.01}), start=Start(velocity_error=1.0))
    built = plant(mechanism, reference, LOOP, longer, 1)
    data = mujoco.MjData(built.model)
    data.qpos[:], data.qvel[:] = built.pose, built.rates
    mujoco.mj_forward(built.model, data)
    B, A = data.site("B_coupler").xpos, data.body("coupler").xpos
    assert np.linalg.norm(B - A) == pytest.approx(1.01 * 0.0741)
    assert np.linalg.norm(B - data.site("B_rocker").xpos) < 1e-12
    assert built.pose[mechanism.independent] == reference.position_rad[0]
    assert np.abs(data.efc_vel[data.efc_type == 0]).max() < 1e-12
    assert abs(built.pose - reference.pose_rad[0]).max() > 1e-3


@pytest.mark.parametrize(
    ("machine", "said"),
    [
        ({"length_factor": {"coupler": 3.0}}, "does not close"),
        ({"length_factor": {"elbow": 1.01}}, "unknown body 'elbow'; legal: thigh, crank"),
        ({"loop_solref": (1e-4, 1.0)}, "at least 2 simulator steps"),
    ],
)
def test_a_machine_that_cannot_be_is_refused_in_one_line(machine, said):
    mechanism, reference = reach()
    with pytest.raises(LinkplanError, match=said):
        plant(mechanism, reference, LOOP, Imperfections(machine=Machine(**machine)), 1)


def test_a_loop_as_stiff_as_the_simulator_can_step_is_not_refused():
    mechanism, reference = reach()
    stiffest = 2 * reference.period_s
    built = plant(mechanism, reference, LOOP, Imperfections(machine=Machine(loop_solref=(stiffest, 1.0))), 1)
    assert np.all(built.model.eq_solref[:, 0] == stiffest)


# A joint off its body's origin; the effort at a ctrl is 2 ctrl + 0.5.
OFF_ORIGIN = """<mujoco><option gravity="0 0 0"/><worldbody><body name="arm" pos="0.1 0 0.2">
<joint name="J" axis="0 1 0" pos="0.3 0 0"/><inertial pos="-0.2 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/>
<site name="tip" pos="0.5 0 0.4"/></body></worldbody><actuator><general name="m" joint="J" gainprm="2" biastype="affine"
biasprm="0.5" ctrlrange="-10 10" ctrllimited="true"/></actuator></mujoco>"""


def off_origin(limit: float = 3.0, **machine) -> mujoco.MjModel:
    mechanism = load_mechanism(OFF_ORIGIN)
    loop = ControlLoop(effort_limit=np.array([[-limit, limit]]))
    return plant(mechanism, hinge_reference(mechanism), loop, Imperfections(machine=Machine(**machine)), 1).model


def test_a_link_grows_about_its_joint():
    distances = []
    for model in (off_origin(), off_origin(length_factor={"arm": 1.25})):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        anchor = data.xanchor[0]
        assert anchor == pytest.approx([0.4, 0.0, 0.2])
        distances.append([data.site("tip").xpos - anchor, data.xipos[1] - anchor])
    assert np.array(distances[1]) == pytest.approx(1.25 * np.array(distances[0]))
