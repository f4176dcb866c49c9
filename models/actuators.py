"""Actuators that a plan can use: efforts bounded on both sides, acting through a joint.

    tau = B u,   B[dof, actuator] = gear,   u = gain * ctrl  in  [lo, hi]

The effort u is MuJoCo's actuator force; its limits are those of `ctrlrange` times the gain, `forcerange`, and the
joint's `actuatorfrcrange` over the gear, all that apply.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from models.tree import HINGE, JOINT_TRANSMISSIONS


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Actuator:
    """A motor on a joint: its effort limits [unit], and where MuJoCo keeps it."""

    name: str
    index: int
    joint: int  # index of the joint it drives
    gear: float
    gain: float  # effort per unit of MuJoCo's ctrl
    lower: float
    upper: float
    unit: str  # "N.m" or "N"


def is_motor(model: mujoco.MjModel, index: int) -> bool:
    """Return whether actuator `index` is a pure effort on a hinge or slide: fixed gain, no bias, no dynamics, no delay.

    One that the model switches off, by itself or by its group, is none.
    """
    switched_off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION) or (
        0 <= int(model.actuator_group[index]) < 31 and model.opt.disableactuator >> int(model.actuator_group[index]) & 1
    )
    return (
        not switched_off
        and float(model.actuator_delay[index]) == 0.0
        and int(model.actuator_trntype[index]) in JOINT_TRANSMISSIONS
        and int(model.actuator_gaintype[index]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        and int(model.actuator_biastype[index]) == int(mujoco.mjtBias.mjBIAS_NONE)
        and int(model.actuator_dyntype[index]) == int(mujoco.mjtDyn.mjDYN_NONE)
        and float(model.actuator_gainprm[index, 0]) != 0.0
        and float(model.actuator_gear[index, 0]) != 0.0
    )


def read_actuators(model: mujoco.MjModel) -> tuple[Actuator, ...]:
    """Return the motors of a model, in file order."""
    return tuple(_read_motor(model, index) for index in range(model.nu) if is_motor(model, index))


def _read_motor(model: mujoco.MjModel, index: int) -> Actuator:
    joint = int(model.actuator_trnid[index, 0])
    gear, gain = float(model.actuator_gear[index, 0]), float(model.actuator_gainprm[index, 0])
    bounds = [(-np.inf, np.inf)]
    clamp = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL)
    if model.actuator_ctrllimited[index] and clamp:
        bounds.append(_scaled(model.actuator_ctrlrange[index], gain))
    if model.actuator_forcelimited[index]:
        bounds.append(_scaled(model.actuator_forcerange[index], 1.0))
    if model.jnt_actfrclimited[joint]:
        bounds.append(_scaled(model.jnt_actfrcrange[joint], 1.0 / gear))
    return Actuator(
        name=model.actuator(index).name or f"actuator {index}",
        index=index,
        joint=int(model.jnt_dofadr[joint]),
        gear=gear,
        gain=gain,
        lower=max(lo for lo, _ in bounds),
        upper=min(hi for _, hi in bounds),
        unit="N.m" if int(model.jnt_type[joint]) == HINGE else "N",
    )


def _scaled(interval: np.ndarray, factor: float) -> tuple[float, float]:
    ends = sorted(float(end) * factor for end in interval)
    return ends[0], ends[1]
