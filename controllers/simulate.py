"""The simulation of a feedback loop from a plant, a law, a reference and machines. A single run is an ensemble of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from linkplan.controllers.feedback_loop import Stepper, run_loop, states_of
from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.imperfections.plant import held_before
from linkplan.controllers.imperfections.sensing import sensing
from linkplan.controllers.mujoco_plant import MujocoPlant, simulation_conditions
from linkplan.controllers.reference import SampledReference, state_at
from linkplan.controllers.rollout import Rollout, divergence_expected
from linkplan.controllers.trackers.tracker import AnyTracker, added, steps_of
from linkplan.models.mechanism import Mechanism


class Plant(Protocol):
    """A simulated mechanism."""

    @property
    def mechanism(self) -> Mechanism:
        """The nominal mechanism, which the tracker uses."""
        ...

    def begin(self, reference: SampledReference, machines: Sequence[Imperfections]) -> tuple[Stepper, list[str | None]]:
        """Return the machines at the start of a reference, and the reason for each that cannot be built, else None."""
        ...


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Ensemble:
    """The logs of n machines at their control instants, time first: (t, n, ...); NaN after a machine was frozen.

    `time_s` (t, n): true time [s]. `pose` (t, n, n_q) and `velocity` (t, n, n_s): true states [rad or m, and per second].
    `commanded` and `applied` (t, n, n_u): the tracker's output and the mean effort of the period [N.m or N]. `power` (t, n):
    sum of the absolute mechanical powers of the actuators [W], NaN on rigid loops. `gap_m` (n,): largest distance between
    points that a closure ties. `contacts` (n,): largest number of contacts. `done` (n,): number of logged instants.
    `failure`: reason why a machine was frozen. `error`: exception of the tracker. `asked_s` (t,): measured computing time
    of the tracker for all machines [s].
    """

    tracker: str
    time_s: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray
    commanded: np.ndarray
    applied: np.ndarray
    power: np.ndarray
    gap_m: np.ndarray
    contacts: np.ndarray
    done: np.ndarray
    failure: tuple[str | None, ...]
    error: tuple[BaseException | None, ...]
    asked_s: np.ndarray
    timestep_s: np.ndarray


def bytes_each(mechanism: Mechanism, instants: int) -> int:
    """Return the memory of one machine's log [bytes]."""
    return 8 * instants * (2 + mechanism.n_q + mechanism.dof + 3 * mechanism.n_u)


@divergence_expected()
def simulate(
    plant: Plant, law: AnyTracker, reference: SampledReference, machines: Sequence[Imperfections] = (Imperfections(),)
) -> Ensemble:
    """Return the logs of a tracker on machines over the whole reference.

    A machine that cannot be built fails before its first instant.

    Args:
        plant: the simulated mechanism.
        law: the tracker, for batches or for single states.
        reference: the sampled motion.
        machines: the imperfections of each machine; default: one nominal machine.
    """
    stepper, failure = plant.begin(reference, machines)
    q, v = states_of(stepper)
    position = q[:, stepper.independent]
    rates = v[:, : position.shape[1]]  # what else a plant measures follows them
    sensors = sensing([one.sensors for one in machines], position, rates, reference.period_s)
    built = np.array([reason is None for reason in failure])
    if not built.all():
        stepper.freeze(~built)
    log = run_loop(stepper, steps_of(law), reference.n, None if sensors.perfect else sensors)
    gap_m, contacts = stepper.gap_and_contacts()
    clocks = [one.clock for one in machines]
    begun = np.array([clock.phase_periods for clock in clocks])
    period = np.array([clock.period_factor for clock in clocks]) * reference.period_s
    return Ensemble(
        tracker=law.name,
        time_s=(np.arange(reference.n)[:, None] + begun) * period,
        pose=log.pose,
        velocity=log.velocity,
        commanded=log.commanded,
        applied=log.applied,
        power=added(np.abs(log.applied * log.speed)),
        gap_m=gap_m,
        contacts=contacts,
        done=log.done,
        failure=tuple(one or other for one, other in zip(failure, log.failure, strict=True)),
        error=tuple(log.error),
        asked_s=log.asked_s,
        timestep_s=stepper.timestep_s,
    )


def simulate_one(plant: MujocoPlant, law: AnyTracker, reference: SampledReference) -> Rollout:
    """Return the log of a tracker on the nominal machine in MuJoCo; the tracker's exception is re-raised."""
    ensemble = simulate(plant, law, reference)
    if ensemble.error[0] is not None:
        raise ensemble.error[0]
    return rollout_of(plant, ensemble, reference)


def rollout_of(plant: MujocoPlant, ensemble: Ensemble, reference: SampledReference) -> Rollout:
    """Return the log of an ensemble's only machine. The log has at least one instant, even if the first command failed."""
    mechanism, loop = plant.mechanism, plant.loop
    kept = slice(0, max(1, int(ensemble.done[0])))
    time, pose = ensemble.time_s[kept, 0], ensemble.pose[kept, 0]
    gaps = mechanism.gaps_by_unit(pose)
    return Rollout(
        tracker=ensemble.tracker,
        time_s=time,
        position_rad=pose[:, mechanism.independent],
        velocity_rad_s=ensemble.velocity[kept, 0],
        reference_rad=state_at(reference, time)[0],
        pose_rad=pose,
        commanded=ensemble.commanded[kept, 0],
        applied=ensemble.applied[kept, 0],
        gap_m=gaps.get("m", np.zeros(len(pose))),
        gap_rad=gaps.get("rad", np.empty(0)),
        contacts=int(ensemble.contacts[0]),
        failure=ensemble.failure[0],
        asked_s=ensemble.asked_s[kept],
        effort_limit=np.array(loop.effort_limit),
        saturated=loop.saturates(ensemble.commanded[kept, 0], reference.period_s, held_before(mechanism, reference, loop)),
        conditions={
            "mechanism": mechanism.name,
            **simulation_conditions(mechanism.model),
            "timestep_s": float(ensemble.timestep_s[0]),
            "control_period_s": reference.period_s,
            "delay_periods": loop.delay_periods,
            "mass_factor": loop.mass_factor,
            "duration_s": reference.period_s * reference.n,
        },
    )
