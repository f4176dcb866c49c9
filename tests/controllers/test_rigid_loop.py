"""The feedback loop on rigid kinematic loops: closed forms, MuJoCo in the limit, and the orders at which it gets there."""

import copy
from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections, Start
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rigid_plant import LOST, RigidPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate
from linkplan.controllers.trackers.computed_torque import computed_torque
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.studies.compare.compare import build_tracker
from tests.support.bodies import HINGE, HINGE_INERTIA, PENDULUM
from tests.support.designs import designed
from tests.support.machines import run_alone
from tests.support.motions import motion_along
from tests.support.plans import optimal
from tests.support.references import cubic_reference, hinge_reference
from tests.support.scripted import Scripted
from tests.support.tolerances_planner import ROUNDING, SAME_FIGURE

# Natural frequency [rad/s] of the errors of computed torque; their damping ratio is 1.
FREQUENCY = 2 * np.pi * 20.0
# Departures [rad] from a path at its start, of up to two joints.
OFF = np.radians([1.0, -0.5])
# What the hold of an effort over a period may do to errors; 0.5 % measured.
ONE_PERCENT = 0.01
# Measured slopes of log error over log timestep, off a whole order: 0.005.
ORDER = 0.02


# Efforts of k + 1 at instant k.
RAMP = Scripted(efforts=np.arange(1.0, 9.0)[:, None])


@dataclass(frozen=True)
class Shove:
    """The reference's efforts, and a thousand times them where the machine is behind its start."""

    reference: SampledReference
    start: float
    name: str = "shove"

    def effort(self, k, position, velocity):  # noqa: ARG002
        return self.reference.effort[k] * (1000.0 if position[0] < self.start else 1.0)


@cache
def reach(name: str, period_s: float, duration_s: float) -> tuple[Mechanism, SampledReference]:
    plan = optimal(name)
    return plan.problem.mechanism, sample(plan.problem.mechanism, plan.trajectory, period_s, duration_s)


def with_steps(mechanism: Mechanism, integrator: mujoco.mjtIntegrator, timestep_s: float) -> Mechanism:
    """Return the mechanism, simulated by another integrator and timestep."""
    model = copy.deepcopy(mechanism.model)
    model.opt.timestep, model.opt.integrator = timestep_s, int(integrator)
    return replace(mechanism, model=model)


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0.0), (0.25, 0.25), (1.0, 1.0), (2.5, 2.5)])
def test_held_and_delayed_efforts_on_a_hinge_are_the_closed_form(delay, late):
    mechanism = load_mechanism(HINGE)
    reference = hinge_reference(mechanism, 8)
    T = reference.period_s
    whole = np.floor(delay)
    clock = Clock(delay_periods=delay - whole)
    runs = simulate(RigidPlant(mechanism=mechanism, delay_periods=whole), RAMP, reference, [Imperfections(clock=clock)])
    # Effort 1 acts until the second command arrives, then each for a period.
    begin = np.concatenate([[0.0], (np.arange(1, 8) + late) * T])
    end = np.append(begin[1:], np.inf)
    for k in range(8):
        held = np.clip(np.minimum(end, k * T) - begin, 0.0, None)
        speed = np.sum(np.arange(1, 9) * held) / HINGE_INERTIA
        assert runs.velocity[k, 0, 0] == pytest.approx(speed, rel=SAME_FIGURE, abs=ROUNDING)


def test_a_long_period_is_integrated_in_steps_of_the_simulator():
    """A rod falls for half a second under a held effort: scipy's answer, for a slow clock beside a fast one too."""
    mechanism = load_mechanism(PENDULUM.format(limit=9))
    rest = sample(mechanism, motion_along([0.0, 1.0], np.zeros((2, 1, 1))), 0.5, 1.0)
    machines = [Imperfections(start=Start(position_error=1.0), clock=Clock(period_factor=f)) for f in (1.0, 0.01)]
    runs = simulate(RigidPlant(mechanism=mechanism), RAMP, rest, machines)
    inertia = 0.01 + 0.25  # kg m2 about the pivot

    def rate(t, x):  # noqa: ARG001
        return [x[1], (1.0 - 9.81 * 0.5 * np.sin(x[0])) / inertia]

    for machine, duration in ((0, 0.5), (1, 0.005)):
        exact = solve_ivp(rate, (0.0, duration), [1.0, 0.0], rtol=1e-12, atol=1e-12).y[:, -1]
        assert [runs.pose[1, machine, 0], runs.velocity[1, machine, 0]] == pytest.approx(exact, abs=1e-8)


def test_a_clock_that_runs_slow_holds_every_effort_longer():
    mechanism = load_mechanism(HINGE)
    reference = hinge_reference(mechanism, 6)
    machines = [Imperfections(), Imperfections(clock=Clock(period_factor=1.5))]
    runs = simulate(RigidPlant(mechanism=mechanism), RAMP, reference, machines)
    np.testing.assert_allclose(runs.velocity[1:, 1], 1.5 * runs.velocity[1:, 0], rtol=SAME_FIGURE)
    np.testing.assert_allclose(runs.pose[1:, 1], 1.5**2 * runs.pose[1:, 0], rtol=SAME_FIGURE)


def test_a_loop_stays_closed_over_a_whole_motion():
    mechanism, reference = reach("knee-reach", 1e-4, 0.16)
    law = build_tracker("pd", optimal("knee-reach"), reference)
    runs = simulate(RigidPlant(mechanism=mechanism), law, reference)
    assert np.degrees(np.abs(reference.pose_rad - runs.pose[:, 0]).max()) > 1
    assert mechanism.gaps_m(runs.pose[:, 0]).max() < 1e-12


def test_a_run_that_is_lost_ends_there_and_harms_no_other():
    mechanism, reference = reach("knee-reach", 1e-3, 0.05)
    machines = [Imperfections(start=Start(position_error=off)) for off in (0.05, -0.05)]
    law = Shove(reference=reference, start=float(reference.position_rad[0, 0]))
    both = simulate(RigidPlant(mechanism=mechanism), law, reference, machines)
    alone = simulate(RigidPlant(mechanism=mechanism), law, reference, machines[:1])
    assert both.failure == (None, LOST)
    assert np.isnan(both.pose[-1, 1]).all()
    np.testing.assert_array_equal(both.pose[:, 0], alone.pose[:, 0])


# Computed torque: e'' + 2 zeta w e' + w^2 e = 0, whose answer for zeta = 1 is e_0 (1 + w t) exp(-w t).


def errors_of_computed_torque(mechanism: Mechanism, reference: SampledReference, *, simulated: bool):
    """Return errors (t, n_s) from a start beside the path, and those that the equation gives."""
    law = computed_torque(designed(mechanism, reference, bandwidth_hz=FREQUENCY / (2 * np.pi), damping_ratio=1.0))
    off = OFF[: mechanism.dof]
    free = ControlLoop(effort_limit=np.tile([-np.inf, np.inf], (mechanism.n_u, 1)))
    plant = MujocoPlant(mechanism=mechanism, loop=free) if simulated else RigidPlant(mechanism=mechanism)
    runs = simulate(plant, law, reference, [Imperfections(start=Start(position_error=-off))])
    time = FREQUENCY * reference.time_s[:, None]
    return reference.position_rad - runs.pose[:, 0, mechanism.independent], off * (1 + time) * np.exp(-time)


@pytest.mark.parametrize(("name", "by"), [("optimus-knee", [1.0]), ("five-bar", [0.1, -0.08])])
def test_the_closed_loop_of_computed_torque_obeys_its_second_order_equation(name, by):
    mechanism = load_mechanism(name)
    reference = cubic_reference(mechanism, np.array(by), 1e-4, 0.08)
    assert np.abs(reference.velocity_rad_s).max() > 1
    errors, wanted = errors_of_computed_torque(mechanism, reference, simulated=False)
    assert np.abs(wanted[-1]).max() < 0.01 * np.abs(wanted[0]).max()
    assert np.all(np.abs(errors - wanted) < ONE_PERCENT * np.abs(wanted[0]))


def share_of_computed_torque(integrator: mujoco.mjtIntegrator, timestep_s: float, *, simulated: bool = True) -> float:
    """Return how far errors leave the equation's on the knee, of the departure at the start; a period is a timestep."""
    mechanism, reference = reach("knee-reach", timestep_s, 0.08)
    errors, wanted = errors_of_computed_torque(with_steps(mechanism, integrator, timestep_s), reference, simulated=simulated)
    return float(np.abs(errors - wanted).max() / np.abs(wanted[0]).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "coarse"),
    [
        (mujoco.mjtIntegrator.mjINT_RK4, 0.0038),  # what the hold of an effort over a period leaves: as on rigid loops
        (mujoco.mjtIntegrator.mjINT_EULER, 0.0247),  # and beside it the integrator's own error, of first order too
    ],
)
def test_in_the_simulator_it_does_so_too_and_what_is_left_vanishes_with_the_period(integrator, coarse):
    periods = (1.6e-4, 8e-5, 4e-5)
    shares = [share_of_computed_torque(integrator, period) for period in periods]
    np.testing.assert_allclose(np.diff(np.log(shares)) / np.diff(np.log(periods)), 1, atol=ORDER)
    assert shares[0] == pytest.approx(coarse, rel=ORDER)
    assert shares[-1] < ONE_PERCENT


@pytest.mark.slow
def test_the_simulator_with_a_fine_integrator_leaves_errors_what_rigid_loops_leave():
    simulated, rigid = (
        share_of_computed_torque(mujoco.mjtIntegrator.mjINT_RK4, 1e-4, simulated=simulated) for simulated in (True, False)
    )
    assert 1e-3 < simulated < ONE_PERCENT
    assert simulated == pytest.approx(rigid, rel=1e-6)


# The limit of a vanishing timestep.


def rms_in_the_simulator(integrator: mujoco.mjtIntegrator, timestep_s: float) -> float:
    """Return the rms error [deg] of pd+ff on the nominal knee, a control period being a timestep."""
    plan = optimal("knee-reach")
    mechanism = with_steps(plan.problem.mechanism, integrator, timestep_s)
    reference = sample(mechanism, plan.trajectory, timestep_s, plan.trajectory.duration_s)
    loop = ControlLoop(effort_limit=plan.problem.limits.actuators_effort)
    followed = run_alone(mechanism, reference, build_tracker("pd+ff", plan, reference), loop)
    assert followed.conditions["timestep_s"] == pytest.approx(timestep_s)
    return float(np.degrees(np.sqrt(np.mean(followed.error_rad**2))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "order", "finest"),
    [
        (mujoco.mjtIntegrator.mjINT_EULER, 1, 0.0242),
        (mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 1, 0.0242),
        # of fourth order itself: what is left is the hold of the feedforward, of second
        (mujoco.mjtIntegrator.mjINT_RK4, 2, 1.36e-5),
    ],
)
def test_on_the_nominal_model_the_error_of_pd_and_feedforward_vanishes_at_the_integrator_s_order(integrator, order, finest):
    timesteps = (8e-4, 4e-4, 2e-4, 1e-4)
    errors = [rms_in_the_simulator(integrator, h) for h in timesteps]
    slopes = np.diff(np.log(errors)) / np.diff(np.log(timesteps))
    np.testing.assert_allclose(slopes, order, atol=ORDER)
    assert errors[-1] == pytest.approx(finest, rel=ORDER)
