"""A knee on its planned reach, and machines with everything wrong with them at once."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from linkplan.controllers.imperfections.imperfections import Clock, Drives, Imperfections, Machine, Push, Sensors, Start
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.simulate import Ensemble, simulate, simulate_one
from linkplan.controllers.trackers.pd import pd
from linkplan.controllers.trackers.tracker import AnyTracker, StateFeedback, with_feedforward
from linkplan.models.mechanism import Mechanism
from tests.support.plans import optimal

LOOP = ControlLoop(effort_limit=np.array([[-100.0, 100.0]]), delay_periods=1)


def run_alone(mechanism: Mechanism, reference: SampledReference, law: AnyTracker, loop: ControlLoop) -> Rollout:
    """Return the run of a law on the nominal machine."""
    return simulate_one(MujocoPlant(mechanism=mechanism, loop=loop), law, reference)


def run_machines(
    mechanism: Mechanism,
    reference: SampledReference,
    law: AnyTracker,
    loop: ControlLoop,
    machines: Sequence[Imperfections],
    threads: int = 0,
) -> Ensemble:
    """Return the runs of a law on machines."""
    return simulate(MujocoPlant(mechanism=mechanism, loop=loop, threads=threads), law, reference, machines)


@cache
def reach(duration_s: float = 0.02, period_s: float = 1e-4) -> tuple[Mechanism, SampledReference]:
    """Return the knee with its shank and the beginning of its planned reach."""
    plan = optimal("knee-reach")
    return plan.problem.mechanism, sample(plan.problem.mechanism, plan.trajectory, period_s, duration_s)


@cache
def follower(duration_s: float = 0.02, period_s: float = 1e-4) -> StateFeedback:
    """Return PD with feedforward on that reach."""
    return with_feedforward(feedback(duration_s, period_s))


@cache
def feedback(duration_s: float = 0.02, period_s: float = 1e-4) -> StateFeedback:
    """Return its PD alone."""
    return pd(*reach(duration_s, period_s), 200.0, 20.0)


def everything(seed: int) -> Imperfections:
    """Return a machine of the knee with every imperfection, of a size that the seed says."""
    size = np.random.default_rng(seed).uniform(0.2, 1.0, 20)
    return Imperfections(
        clock=Clock(period_factor=1 + 0.01 * size[0], phase_periods=0.5 * size[1], delay_periods=1.5 * size[2]),
        sensors=Sensors(
            resolution=1e-4 * size[3],
            offset=1e-3 * size[4],
            noise=1e-5 * size[5],
            velocity_noise=0.01 * size[6],
            velocity_filter_hz=None if seed % 2 else 500.0 * size[7],
            noise_seed=(7, seed),
        ),
        drives=Drives(
            resolution=0.1 * size[8],
            constant_factor=1 + 0.1 * size[9],
            bandwidth_hz=1000.0 * size[10],
            rate_limit=1e5 * size[11],
        ),
        machine=Machine(
            viscous=np.array([0.1, 0.01, 0.02]) * size[12],
            coulomb=0.1 * size[13],
            mass_factor=1 + 0.2 * size[14],
            com_shift_m=np.array([0.01, 0.0, -0.01]) * size[15],
            length_factor={"coupler": 1 + 0.005 * size[16]},
            loop_solref=(3e-4, 1.0 + size[17]),
        ),
        start=Start(position_error=1e-3 * size[18], velocity_error=0.1 * size[19]),
        pushes=(Push(start_s=0.00505, duration_s=0.003, body="coupler", force=np.array([10.0, 0.0, 5.0])),),
    )
