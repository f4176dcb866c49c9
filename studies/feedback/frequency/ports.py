"""Inputs and outputs of a plant by name: efforts of actuators or on joints; positions of joints, sites and bodies.

An output is a name that the mechanism has: `knee` of a joint [rad or m], `foot.z` of a site's coordinate in the world [m],
`body.shank` of a body's angle [rad]. About a pose it moves by a row c (n_s,) of the independent coordinates.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkplan.models.actuation.distribution import unit_efforts
from linkplan.models.errors import LinkplanError, nearest
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled, site_motion
from linkplan.models.tree.dynamics import site_index, site_names
from linkplan.models.tree.joints import unit_steps
from linkplan.planner.problem.sites import AXES, angles_of, places_of, turning_body
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint

# A slope below this, in unit steps per unit step, is a rounding error of the assembly: the output is at a dead centre.
_ZERO_SLOPE = 1e-10
# The prefix of an output that is the angle of a body.
_OF_BODY = "body."


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PlantInput:
    """An effort by its name and unit. `push` gives the actuators' efforts (n_u,) for one unit of it at a point."""

    name: str
    unit: str
    push: Callable[[OperatingPoint], np.ndarray]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PlantOutput:
    """A position by its name and unit. `at_poses` gives it (n,) [rad or m] at poses q (n, n_q).

    `slopes` gives its derivatives c (n_s,) by the independent coordinates at a pose (n_q,).
    """

    name: str
    unit: str
    at_poses: Callable[[np.ndarray], np.ndarray]
    slopes: Callable[[np.ndarray], np.ndarray]


def gain_unit(one: PlantInput, out: PlantOutput) -> str:
    """Return the unit of a response from an input to an output: m/N, rad/(N.m)."""
    return f"{out.unit}/({one.unit})" if "." in one.unit else f"{out.unit}/{one.unit}"


def pair_name(one: PlantInput, out: PlantOutput) -> str:
    """Return the name of the response from an input to an output."""
    return f"{one.name} to {out.name}"


def plant_input(mechanism: Mechanism, name: str, what: str) -> PlantInput:
    """Return the effort of an actuator, or else on a joint with a feedback loop, shared by the actuators that move it.

    Raises:
        LinkplanError: for any other name; the message has `what` and the legal names.
    """
    actuators = [actuator.name for actuator in mechanism.actuators]
    joints = [mechanism.independent_joints[channel].name for channel in mechanism.channels]
    if name in actuators:
        k = actuators.index(name)
        push = np.eye(mechanism.n_u)[k]
        return PlantInput(name=name, unit=mechanism.actuators[k].unit, push=lambda _: push)
    if name not in joints:
        raise LinkplanError(
            f"{what} must name an effort of an actuator ({', '.join(actuators)}) or on a driven joint"
            f" ({', '.join(joints)}); got"
            f" '{name}'{nearest(name, [*actuators, *joints])}"
        )
    channels, i = list(mechanism.channels), joints.index(name)

    def shared(point: OperatingPoint) -> np.ndarray:
        effort_map = np.array(mechanism.dynamics.effort_map(point.pose))[channels]
        return unit_efforts(effort_map)[:, i]

    return PlantInput(name=name, unit=mechanism.independent_joints[channels[i]].si_units[1], push=shared)


def plant_output(mechanism: Mechanism, name: str, what: str) -> PlantOutput:
    """Return the position of a joint, of a site along an axis (`foot.z`), or of a body about its axis (`body.shank`).

    Raises:
        LinkplanError: for any other name, or a body without a single angle; the message has `what` and the legal names.
    """
    joints, sites = [joint.name for joint in mechanism.joints], site_names(mechanism.model)

    steps = unit_steps(mechanism.joints, mechanism.extent_m)[mechanism.independent]

    def known(row: np.ndarray, unit: str) -> np.ndarray:
        size = 1.0 if unit == "rad" else mechanism.extent_m
        return np.where(np.abs(row) * steps > _ZERO_SLOPE * size, row, 0.0)

    def of_joints(sigma: np.ndarray, unit: str) -> Callable[[np.ndarray], np.ndarray]:
        return lambda pose: known(sigma @ np.array(mechanism.dynamics.velocity_map(pose)), unit)

    if name in joints:
        k = joints.index(name)
        unit = mechanism.joints[k].si_units[0]
        return PlantOutput(name=name, unit=unit, at_poses=lambda q: q[:, k], slopes=of_joints(np.eye(len(joints))[k], unit))
    site, _, axis = name.rpartition(".")
    if site in sites and axis in AXES:
        index, along = site_index(mechanism.model, site, what, LinkplanError), AXES.index(axis)

        def of_site(pose: np.ndarray) -> np.ndarray:
            n_s = mechanism.dof
            still = np.zeros((n_s, n_s))
            speeds = sampled(site_motion(mechanism, 1), np.tile(pose, (n_s, 1)), np.eye(n_s), still)
            return known(speeds[:, along, index], "m")

        return PlantOutput(name=name, unit="m", at_poses=lambda q: places_of(mechanism, index, q)[:, along], slopes=of_site)
    if name.startswith(_OF_BODY):
        body = turning_body(name.removeprefix(_OF_BODY), what, mechanism)
        sigma = angles_of(mechanism, body, np.eye(mechanism.n_q))
        return PlantOutput(
            name=name, unit="rad", at_poses=lambda q: angles_of(mechanism, body, q), slopes=of_joints(sigma, "rad")
        )
    legal = [*joints, *(f"{site}.{axis}" for site in sites for axis in AXES)]
    of_sites = f", a coordinate of a site ({', '.join(sites)}) such as {sites[0]}.x," if sites else ""
    raise LinkplanError(
        f"{what} must name a position of a joint ({', '.join(joints)}){of_sites} or the angle of a body as {_OF_BODY}NAME;"
        " got"
        f" '{name}'{nearest(name, legal)}"
    )
