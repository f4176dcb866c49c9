"""A machine on the ground in MuJoCo: real contacts at its feet, which are not closures, and sensors of their forces.

Feet whose bodies have geoms that collide with the ground keep these. Others get a sphere at the site, on a plane that is
lower by its radius, so that the site itself touches the ground.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import mujoco
import numpy as np

from linkplan.controllers.feedback_loop import Stepper
from linkplan.controllers.imperfections.driving import DriveState, driving
from linkplan.controllers.imperfections.imperfections import Drives, Imperfections, Machine
from linkplan.controllers.imperfections.plant import ImperfectPlant, change_numbers, prepare
from linkplan.controllers.mujoco_plant import MujocoStepper
from linkplan.controllers.reference import SampledReference
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.sampling import substeps_of
from linkplan.controllers.trackers.tracker import added
from linkplan.models.mechanism import Mechanism
from linkplan.models.selected_model import whole_spec

# The added geoms touch nothing but each other: their bit among the types of contacts.
_OWN_TYPE = 1 << 30
_RADIUS_SHARE = 1e-3
# How far the ground is above where the feet stand [radii]: MuJoCo has no contact between geoms that only just touch.
_OVERLAP_SHARE = 1e-3
# The colour of the ground, and half the length and width [extents] of what is drawn of it.
_GROUND, _STRIP = (0.82, 0.82, 0.82, 1.0), (20.0, 0.05)
# The friction of a foot that does not slip, and MuJoCo's ratio of friction's to the normal direction's stiffness.
_NO_SLIP, _FRICTION_STIFFNESS = 10.0, 100.0
# MuJoCo's shortest time constant of a contact [timesteps], critically damped: a plastic impact.
_STIFFEST = (2.0, 10.0)
# Simulator steps of a control period, at least, so that an impact is over within a period.
_STEPS_OF_IMPACT = 8


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Foot:
    """A site that may touch the ground.

    Args:
        site: its name.
        body: of the site, by name.
        place: in the body (3,) [m].
        friction: the coefficient; None if it does not slip.
        ground: a point of the ground and its normal (6,).
    """

    site: str
    body: str
    place: np.ndarray
    friction: float | None
    ground: np.ndarray


def on_ground(mechanism: Mechanism, feet: Sequence[Foot], timestep_s: float) -> mujoco.MjModel:
    """Return a mechanism's model with contacts at its feet; its last sensors are their normal forces [N], in order."""
    spec, model = whole_spec(mechanism), mechanism.model
    body, sensor = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtSensor.mjSENS_CONTACT
    own = {foot.site: _collides(model, model.body(foot.body).id) for foot in feet}
    if not all(own.values()):
        spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _FRICTION_STIFFNESS
    radius, force = _RADIUS_SHARE * mechanism.extent_m, [1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1]
    grounds: dict[bytes, str] = {}
    for foot in feet:
        of = spec.body(foot.body)
        sensed = {"objtype": body, "objname": of.name, "reftype": body, "refname": spec.worldbody.name}
        if not own[foot.site]:
            friction = [_NO_SLIP if foot.friction is None else foot.friction, 0.0, 0.0]
            solref = [_STIFFEST[0] * timestep_s, _STIFFEST[1]]
            if (key := foot.ground.tobytes()) not in grounds:
                grounds[key] = f"ground {len(grounds)} under feet"
                _add_plane(spec, grounds[key], foot.ground, radius, solref)
            name = f"foot {foot.site}"
            of.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=foot.place, mass=0.0, condim=3,
                friction=friction, solref=solref, contype=_OWN_TYPE, conaffinity=0, priority=1, group=5,
            )  # fmt: skip
            geom = mujoco.mjtObj.mjOBJ_GEOM
            sensed = {"objtype": geom, "objname": name, "reftype": geom, "refname": grounds[key]}
        spec.add_sensor(name=f"force on {foot.site}", type=sensor, intprm=force, **sensed)
    return spec.compile()


def _add_plane(spec: mujoco.MjSpec, name: str, ground: np.ndarray, radius: float, solref: Sequence[float]) -> None:
    """Add a plane to a specification, under a point of the ground with a normal (6,) by a radius [m].

    It has no end for contacts, and is drawn as a strip along x.
    """
    turn, normal = np.zeros(4), ground[3:] / np.linalg.norm(ground[3:])
    size = [*(np.array(_STRIP) * radius / _RADIUS_SHARE), 1.0]
    place = ground[:3] - (1 - _OVERLAP_SHARE) * radius * normal
    mujoco.mju_quatZ2Vec(turn, normal)
    spec.worldbody.add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=size, pos=place, rgba=_GROUND, quat=turn,
        friction=[0.0, 0.0, 0.0], solref=solref, contype=0, conaffinity=_OWN_TYPE,
    )  # fmt: skip


def _collides(model: mujoco.MjModel, body: int) -> bool:
    """Return whether a geom of a body can touch one that is fixed to the world."""
    geoms = np.flatnonzero(model.geom_bodyid == body)
    fixed = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0)
    kind, reach = model.geom_contype, model.geom_conaffinity
    meets = (kind[geoms][:, None] & reach[fixed]) | (reach[geoms][:, None] & kind[fixed])
    return bool(np.any(meets))


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class GroundPlant:
    """A mechanism without closures for its contacts, its feet, and the drives of its feedback loop.

    A law measures all joints: its positions are the pose (n_q,), and its velocities the rates (n_q,) and the feet's normal
    forces (n_feet,), averaged over the last control period [N].
    """

    mechanism: Mechanism
    feet: tuple[Foot, ...]
    loop: ControlLoop

    def begin(self, reference: SampledReference, machines: Sequence[Imperfections]) -> tuple[Stepper, list[str | None]]:
        """Return nominal machines at the start of a reference of all joints."""
        mechanism, loop = self.mechanism, self.loop
        substeps = max(substeps_of(mechanism, reference.period_s), _STEPS_OF_IMPACT)
        model = on_ground(mechanism, self.feet, reference.period_s / substeps)
        change_numbers(model, Machine(), loop.mass_factor)
        prepare(model, mechanism, reference.period_s / substeps, loop.effort_limit)
        plant = ImperfectPlant(model=model, pose=reference.pose_rad[0], rates=reference.velocity_rad_s[0])
        n = len(machines)
        drives = driving(
            [Drives()] * n,
            [loop.delay_periods] * n,
            [float(model.opt.timestep)] * n,
            substeps,
            loop.effort_limit,
            reference.effort[0],
            line=loop.motor_line,
            slowest=loop.rate_limit,
        )
        normals = np.array([foot.ground[3:] for foot in self.feet]).reshape(-1, 3)
        return GroundStepper(mechanism, [plant] * n, drives, substeps, normals=normals), [None] * n


class GroundStepper(MujocoStepper):
    """Machines in MuJoCo whose law measures all joints, and the feet's mean normal forces of the last control period.

    The model's last sensors are the feet's. `normals` (n_feet, 3) are the ground's.
    """

    def __init__(
        self,
        mechanism: Mechanism,
        plants: Sequence[ImperfectPlant],
        drives: DriveState,
        substeps: int,
        *,
        normals: np.ndarray,
    ) -> None:
        super().__init__(mechanism, plants, drives, substeps, watched=True, begun=np.zeros(len(plants)))
        self.independent = cast("np.ndarray | slice", slice(None))
        self.n_s = mechanism.n_q + len(normals)
        self._normals, sensed = normals, self._batch.bind("sensordata")
        self._sensed = sensed[:, sensed.shape[1] - normals.size :]
        self._sum = np.zeros((self.n, len(normals)))
        self._stretches = [(j, 1) for j in range(substeps)]

    def note_step(self) -> None:
        """Add the feet's forces to those of the control period."""
        self._sum += np.abs(added(self._sensed.reshape(self.n, *self._normals.shape) * self._normals))

    def read(self, pose: np.ndarray, velocity: np.ndarray) -> None:
        """Write the machines' poses (n, n_q), and their rates and contact forces (n, n_q + n_feet)."""
        super().read(pose, velocity[:, : self.n_q])
        velocity[:, self.n_q :] = self._sum / self._substeps
        self._sum[:] = 0.0
