"""Many MuJoCo simulations at once: their own model fields, pushes on them, and their closure gaps and contacts.

In one batch each simulation has its own copy of the model fields that differ. Separate models (`Batch.set_models`) give the
same results, but a step takes half as long again, because each model's memory is read separately. Pushes are forces on
bodies and efforts on joints during time windows. Gaps follow from MuJoCo's positions of the tied points: MuJoCo's arrays are
copied after every step and evaluated for many steps together, because an evaluation takes longer than a step.
"""

import operator
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco.batch import MODEL_FIELDS, Batch

from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.imperfections.plant import ImperfectPlant, body_index
from linkplan.controllers.trackers.tracker import added
from linkplan.models.errors import LinkplanError
from linkplan.models.external_forces import loads_of
from linkplan.models.kinematics import tied_points
from linkplan.models.mechanism import Mechanism


def spread(batch: Batch, base: mujoco.MjModel, models: Sequence[mujoco.MjModel]) -> None:
    """Expand every field of a batch in which some model differs from the base model."""
    unlike = [model for model in models if model is not base]
    for name in sorted(MODEL_FIELDS):
        value = operator.attrgetter(name)
        common = np.asarray(value(base)).tobytes()  # ten times as fast as numpy.array_equal
        if any(np.asarray(value(model)).tobytes() != common for model in unlike):
            batch.expand(name)[:] = [value(model) for model in models]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PushState:
    """Pushes (n, m) on simulations, from `start` to `end` [simulator steps of each simulation]; m is the largest number.

    `force` (n, m, nbody, 6) [N, N.m] acts at the bodies' centres of mass, `effort` (n, m, nv) [N.m or N] on joints.
    """

    start: np.ndarray
    end: np.ndarray
    force: np.ndarray
    effort: np.ndarray

    def over(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean forces (n, nbody, 6) and efforts (n, nv) over a simulator step."""
        share = np.maximum(np.minimum(step + 1.0, self.end) - np.maximum(float(step), self.start), 0.0)
        force, effort = np.zeros(self.force[:, 0].shape), np.zeros(self.effort[:, 0].shape)
        for i in range(share.shape[1]):  # a fixed order of summation keeps the last bit reproducible
            force += share[:, i, None, None] * self.force[:, i]
            effort += share[:, i, None] * self.effort[:, i]
        return force, effort


def pushing(
    machines: Sequence[Imperfections], plants: Sequence[ImperfectPlant], mechanism: Mechanism, substeps: int
) -> PushState | None:
    """Return the pushes on machines, or None if no machine has one.

    Raises:
        LinkplanError: for an unknown body or joint.
    """
    n, most, model = len(machines), max((len(one.pushes) for one in machines), default=0), mechanism.model
    if most == 0:
        return None
    start, end = np.zeros((n, most)), np.zeros((n, most))
    force, effort = np.zeros((n, most, model.nbody, 6)), np.zeros((n, most, model.nv))
    for i, (one, built) in enumerate(zip(machines, plants, strict=True)):
        h, begun = float(built.model.opt.timestep), one.clock.phase_periods * substeps
        for m, push in enumerate(one.pushes):
            start[i, m] = push.start_s / h - begun
            end[i, m] = start[i, m] + push.duration_s / h
            if push.body is not None and push.force is not None:
                force[i, m, body_index(mechanism.model, push.body), :3] = push.force
            if push.joint is not None:
                effort[i, m, mechanism.joint_index(push.joint, LinkplanError)] = push.effort
    return PushState(start=start, end=end, force=force, effort=effort)


class SiteForces:
    """The forces over time of simulations (n,), applied at their sites at the beginning of every simulator step.

    Args:
        batch: the simulations, whose sites are known before a step.
        mechanism: with forces over time.
        timesteps_s: (n,) [s].
        begun: simulator steps (n,) of each simulation before the first one.
    """

    def __init__(self, batch: Batch, mechanism: Mechanism, timesteps_s: np.ndarray, begun: np.ndarray) -> None:
        assert mechanism.forces is not None
        model = mechanism.model
        self._mechanism, self._timesteps_s, self._begun = mechanism, timesteps_s, begun
        self._sites = [int(model.site(name).id) for name in mechanism.forces.sites]
        self._bodies = [int(model.site_bodyid[site]) for site in self._sites]
        self._places, self._centres = batch.bind("site_xpos"), batch.bind("xipos")

    def add(self, step: int, force: np.ndarray) -> None:
        """Add the forces at the middle of a simulator step to those (n, nbody, 6) at the bodies' centres of mass."""
        (given,) = self._mechanism.forces_at((self._begun + step + 0.5) * self._timesteps_s)
        for k, (site, body) in enumerate(zip(self._sites, self._bodies, strict=True)):
            push = given[:, 3 * k : 3 * k + 3]
            force[:, body, :3] += push
            force[:, body, 3:] += np.cross(self._places[:, site] - self._centres[:, body], push)


class LoadForces:
    """The loads over a place or a speed of simulations (n,), applied at the beginning of every simulator step.

    A site's place is that of MuJoCo. Its velocity follows from that of its body about the centre of mass of the whole tree.
    """

    def __init__(self, batch: Batch, model: mujoco.MjModel) -> None:
        self._model, self._loads = model, loads_of(model)
        names = ("qpos", "qvel", "site_xpos", "xipos", "cvel", "subtree_com")
        self._qpos, self._qvel, self._places, self._centres, self._twists, self._roots = map(batch.bind, names)

    def add(self, force: np.ndarray, effort: np.ndarray) -> None:
        """Add the loads to forces (n, nbody, 6) at the bodies' centres of mass and to efforts (n, nv) on joints."""
        model = self._model
        for load in self._loads:
            joint, speed = load.joint(model), load.over == "speed"
            if joint is not None:
                at = self._qvel[:, model.jnt_dofadr[joint]] if speed else self._qpos[:, model.jnt_qposadr[joint]]
            if load.on == "joint":
                effort[:, model.jnt_dofadr[model.joint(load.name).id]] += load.values(at)
                continue
            site = int(model.site(load.name).id)
            body, place = int(model.site_bodyid[site]), self._places[:, site]
            if joint is None:
                arm, twist = place - self._roots[:, model.body_rootid[body]], self._twists[:, body]
                at = (twist[:, 3:] + np.cross(twist[:, :3], arm) if speed else place) @ load.axis
            push = load.values(at)[:, None] * load.axis
            force[:, body, :3] += push
            force[:, body, 3:] += np.cross(place - self._centres[:, body], push)


class ClosureWatch:
    """The largest gap of tied points and the largest number of contacts of a batch's simulations so far.

    A frozen simulation keeps its last state, which changes neither maximum.
    """

    def __init__(self, batch: Batch, models: Sequence[mujoco.MjModel]) -> None:
        model, n = models[0], len(models)
        ties = [i for i in np.flatnonzero(model.eq_active0).tolist() if tied_points(model, i)]
        self._model = model
        self._at_sites = [i for i in ties if model.eq_objtype[i] == int(mujoco.mjtObj.mjOBJ_SITE)]
        self._at_bodies = [i for i in ties if i not in self._at_sites]
        self._anchors = [
            [np.array([tied_points(one, i)[end][1] for one in models]) for end in (0, 1)] for i in self._at_bodies
        ]
        names = ["ncon", *(["site_xpos"] if self._at_sites else []), *(["xpos", "xmat"] if self._at_bodies else [])]
        self._live = {name: batch.bind(name) for name in names}
        size = sum(array.nbytes for array in self._live.values())
        steps = max(1, min(64, 8_388_608 // max(size, 1)))  # copies of at most 8 MiB
        self._copies = {name: np.empty((steps, *array.shape), array.dtype) for name, array in self._live.items()}
        self._pairs = [(self._copies[name], array) for name, array in self._live.items()]
        self._steps, self._noted = steps, 0
        self._squares, self._contacts = np.zeros(n), np.zeros(n, dtype=int)

    def note(self) -> None:
        """Copy the simulations' present positions and contacts."""
        for copies, live in self._pairs:
            copies[self._noted] = live
        self._noted += 1
        if self._noted == self._steps:
            self._evaluate()

    def largest(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest gaps [m] and numbers of contacts (n,) over all copies."""
        self._evaluate()
        return np.sqrt(self._squares), self._contacts

    def _evaluate(self) -> None:
        noted, self._noted = self._noted, 0
        if not noted:
            return
        copies, model = {name: array[:noted] for name, array in self._copies.items()}, self._model
        self._contacts = np.maximum(self._contacts, copies["ncon"].reshape(noted, -1).max(axis=0))
        for i in self._at_sites:
            sites = copies["site_xpos"]
            self._widen(sites[:, :, model.eq_obj1id[i]] - sites[:, :, model.eq_obj2id[i]])
        for i, anchors in zip(self._at_bodies, self._anchors, strict=True):
            ends = []
            for body, anchor in zip((model.eq_obj1id[i], model.eq_obj2id[i]), anchors, strict=True):
                turn = copies["xmat"][:, :, body].reshape(noted, -1, 3, 3)
                ends.append(copies["xpos"][:, :, body] + added(turn * anchor[:, None]))
            self._widen(ends[0] - ends[1])

    def _widen(self, gap: np.ndarray) -> None:
        """Update the largest gap with vectors (steps, n, 3) between two tied points."""
        self._squares = np.fmax(self._squares, np.fmax.reduce(added(gap**2), axis=0))
