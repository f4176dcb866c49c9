"""PD in the independent joints, and gain-scheduled PD.

Gains proportional to the reduced inertia give the same bandwidth and damping ratio at every pose.
"""

import numpy as np

from linkplan.controllers.reference import SampledReference
from linkplan.controllers.trackers.tracker import Design, StateFeedback, with_feedforward
from linkplan.models.actuation.distribution import unit_efforts
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled


def pd(mechanism: Mechanism, reference: SampledReference, kp: float | np.ndarray, kd: float | np.ndarray) -> StateFeedback:
    """Return u = (Gamma^T B)^+ [kp (s_ref - s) + kd (v_ref - v)].

    kp [N.m/rad or N/m] and kd [N.m.s/rad or N.s/m], one for all or one for each (n_s,), act on the independent joints.
    """
    gains = pd_gain(_effort_maps(mechanism, reference), kp, kd)
    return StateFeedback(reference=reference, gains=gains, name="pd")


def pd_for(design: Design) -> StateFeedback:
    """Return the PD tracker of a design."""
    return pd(design.mechanism, design.reference, *design.settings.gains(design.mechanism.independent_joints))


def pd_ff_for(design: Design) -> StateFeedback:
    """Return the PD tracker of a design with the reference's efforts."""
    return with_feedforward(pd_for(design))


def gs_pd_ff_for(design: Design) -> StateFeedback:
    """Return PD with gains M_r w^2 and 2 zeta w M_r along a reference, M_r the reduced inertia, with its efforts."""
    mechanism, reference, (natural_frequency, damping_ratio) = design.mechanism, design.reference, design.of_errors
    maps = _effort_maps(mechanism, reference) @ sampled(mechanism.dynamics.reduced_inertia, reference.pose_rad)
    gains = pd_gain(maps, natural_frequency**2, 2 * damping_ratio * natural_frequency)
    return with_feedforward(StateFeedback(reference=reference, gains=gains, name="gs-pd"))


def pd_gain(effort_map: np.ndarray, kp: float | np.ndarray, kd: float | np.ndarray) -> np.ndarray:
    """Return PD's gains K (..., n_u, 2 n_s) on the state, with a map (..., n_u, n_s) from joint to actuator efforts.

    kp and kd are one number for all joints, or one for each joint (n_s,).
    """
    return np.concatenate([kp * effort_map, kd * effort_map], axis=-1)


def _effort_maps(mechanism: Mechanism, reference: SampledReference) -> np.ndarray:
    """Return the maps (n, n_u, n_s) from joint to actuator efforts along a reference."""
    return unit_efforts(sampled(mechanism.dynamics.effort_map, reference.pose_rad))
