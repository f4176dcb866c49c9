"""Linkages driven through gears, screws, racks and cranks, and their statics and dynamics by MuJoCo's rows alone."""

from dataclasses import dataclass

import mujoco
import numpy as np

_HEAD = """<compiler angle="degree" autolimits="true"/><default><joint axis="0 -1 0"/>
  <geom type="capsule" size="0.01" contype="0" conaffinity="0"/></default><worldbody>"""
# By name: the model, the joint whose loop is closed, and its motor's reach [rad or m].
MODELS = {
    "geared crank": (
        f"""<mujoco><option timestep="2e-4"/>{_HEAD}
  <body pos="0 .2 0"><joint name="motor"/><inertial mass="0.2" pos="0 0 0" diaginertia="3e-5 3e-5 3e-5"/></body>
  <body><joint name="crank"/><geom fromto="0 0 0 0.08 0 0" mass="0.3"/>
    <body name="rod" pos="0.08 0 0"><joint name="rod"/><geom fromto="0 0 0 0.25 0 0" mass="0.4"/></body></body>
  <body name="ram" pos="0.33 0 0"><joint name="ram" type="slide" axis="1 0 0"/><geom fromto="0 0 0 0 0 .1" mass="6"/></body>
  </worldbody><equality><connect body1="rod" body2="ram" anchor="0.25 0 0"/>
  <joint joint1="motor" joint2="crank" polycoef="0 12 0 0 0"/></equality>
  <actuator><motor joint="motor" ctrlrange="-9 9"/></actuator></mujoco>""",
        "crank",
        (-24 * np.pi, 24 * np.pi),
    ),
    "scissor lift": (
        f"""<mujoco><option timestep="5e-4"/>{_HEAD}
  <body pos="-.5 0 0"><joint name="motor" axis="1 0 0"/>
    <inertial mass="0.4" pos="0 0 0" diaginertia="4e-5 2e-5 2e-5"/></body>
  <body name="left"><joint name="left"/><geom fromto="0 0 0 .4 0 .3" mass="2"/></body>
  <body pos=".4 0 0"><joint name="foot" type="slide" axis="1 0 0" range="-.2 .05"/><geom fromto="0 -.1 0 0 .1 0" mass="1"/>
    <body name="right"><joint name="right"/><geom fromto="0 0 0 -.4 0 .3" mass="2"/>
      <body pos="-.4 0 .3"><joint name="level"/><geom fromto="0 0 0 .4 0 0" mass="10"/></body></body></body>
  </worldbody><equality><connect body1="left" body2="right" anchor=".2 0 .15"/>
  <joint joint1="motor" joint2="foot" polycoef="0 1200 0 0 0"/>
  <joint joint1="level" joint2="right" polycoef="0 -1 0 0 0"/></equality>
  <actuator><motor joint="motor" ctrlrange="-9 9"/></actuator></mujoco>""",
        "left",
        (-240.0, 60.0),
    ),
    "rack and rocker": (
        f"""<mujoco><option timestep="2e-4"/>{_HEAD}
  <body pos="0 .1 0"><joint name="pinion"/><geom type="cylinder" size=".02 .01" euler="90 0 0" mass=".3"/></body>
  <body><joint name="rack" type="slide" axis="1 0 0" range="-.12 .12" damping="5"/><geom fromto="-.1 0 0 .1 0 0" mass="1"/>
    <body name="rod" pos=".1 0 0"><joint name="rod"/><geom fromto="0 0 0 .25 0 .15" mass=".3"/></body></body>
  <body name="arm" pos=".35 0 -.05"><joint name="arm"/><geom fromto="0 0 0 0 0 .2" mass=".5"/>
    <geom fromto="0 0 .2 .1 0 .4" mass="1"/></body>
  </worldbody><equality><connect body1="rod" body2="arm" anchor=".25 0 .15"/>
  <joint joint1="rack" joint2="pinion" polycoef="0 0.02 0 0 0"/></equality>
  <actuator><motor joint="pinion" ctrlrange="-9 9"/></actuator></mujoco>""",
        "arm",
        (-6.0, 6.0),
    ),
    "four-bar hatch": (
        f"""<mujoco><option timestep="5e-4"/>{_HEAD}
  <body><joint name="drive" range="-20 100"/><geom fromto="0 0 0 0 0 .12" mass=".5"/>
    <body name="link" pos="0 0 .12"><joint name="knuckle"/><geom fromto="0 0 0 .3 0 .05" mass=".4"/></body></body>
  <body name="lid" pos=".3 0 0"><joint name="lid" damping=".5"/><geom fromto="0 0 0 0 0 .17" mass=".5"/>
    <geom fromto="0 0 0 .5 0 .1" mass="4"/></body>
  </worldbody><equality><connect body1="link" body2="lid" anchor=".3 0 .05"/></equality>
  <actuator><motor joint="drive" gear="50" ctrlrange="-9 9"/></actuator></mujoco>""",
        "lid",
        (np.radians(-20), np.radians(100)),
    ),
}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class OneFreedom:
    """A closed pose of a mechanism of one freedom, in units of one joint: a motor's ratio, the inertia, efforts."""

    ratio: float
    inertia: float
    effort: float  # that holds weight and springs
    damping: float


class Linkage:
    """A model of one freedom, closed by Newton on MuJoCo's own constraint rows; knows nothing of linkplan."""

    def __init__(self, text: str, joint: str) -> None:
        self.model = mujoco.MjModel.from_xml_string(text)
        self.model.opt.jacobian = int(mujoco.mjtJacobian.mjJAC_DENSE)
        self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self.data = mujoco.MjData(self.model)
        self.joint = int(self.model.joint(joint).dofadr[0])
        self.pose = np.array(self.model.qpos0)

    def rows(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Jacobian and the residual of the equality rows at q, at rest."""
        self.data.qpos[:], self.data.qvel[:] = q, 0.0
        mujoco.mj_forward(self.model, self.data)
        return np.array(self.data.efc_J).reshape(-1, self.model.nv), np.array(self.data.efc_pos)

    def closed(self, near: np.ndarray, position: float) -> np.ndarray:
        """Return the pose with the joint at a position, followed from a near pose."""
        q, free = near.copy(), [i for i in range(self.model.nv) if i != self.joint]
        for place in np.linspace(q[self.joint], position, 2 + int(abs(position - q[self.joint]) / 0.01))[1:]:
            q[self.joint] = place
            for _ in range(20):
                J, r = self.rows(q)
                q[free] -= np.linalg.lstsq(J[:, free], r, rcond=1e-12)[0]
        assert np.abs(self.rows(q)[1]).max() < 1e-11
        return q

    def at(self, q: np.ndarray) -> OneFreedom:
        """Return the quantities at a closed pose."""
        J, _ = self.rows(q)
        null = np.linalg.svd(J)[2][-1]
        moved = null / null[self.joint]
        self.data.qvel[:] = moved
        mujoco.mj_forward(self.model, self.data)
        ratio = float(self.data.actuator_velocity[0])
        self.rows(q)
        product = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, product, moved)
        held = moved @ (np.array(self.data.qfrc_bias) - np.array(self.data.qfrc_passive))
        damping = float(moved**2 @ np.array(self.model.dof_damping))
        return OneFreedom(ratio=ratio, inertia=float(moved @ product), effort=float(held), damping=damping)

    def stiffness(self, q: np.ndarray, step: float = 1e-5) -> float:
        """Return the stiffness of weight, springs and transmission while the actuator keeps the effort that holds q."""
        here = self.at(q)
        effort = here.effort / here.ratio
        ends = [self.at(self.closed(q, q[self.joint] + way)) for way in (-step, step)]
        pulls = [one.ratio * effort - one.effort for one in ends]
        return -(pulls[1] - pulls[0]) / (2 * step)
