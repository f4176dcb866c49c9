"""A plan as a joint trajectory of ROS: the message trajectory_msgs/JointTrajectory as YAML."""

import json
from collections.abc import Sequence

import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.studies.handover.export.output_joints import with_outputs
from linkplan.studies.handover.export.samples import ExportedSamples


def joint_trajectory_text(samples: ExportedSamples, joints: Sequence[str] = ()) -> str:
    """Return the YAML of a trajectory_msgs/msg/JointTrajectory: the independent joints, in radians or metres.

    `effort` of a joint is the actuators' effort on that coordinate, Gamma^T B u [N.m or N]. For a motor on the joint it is
    its torque times its gear. With `joints`, these output joints replace the independent ones. Their number is that of the
    degrees of freedom without rods' passive spins, and the power of their efforts equals that of the actuators.

    Raises:
        LinkplanError: if the joints cannot be the mechanism's coordinates.
    """
    mechanism = samples.plan.problem.mechanism
    if joints:
        shown = [mechanism.joint_index(name, ProblemError) for name in joints]
        if len(joints) > mechanism.dof:
            raise ProblemError(f"joints must be {mechanism.dof}, one for each degree of freedom, got {len(joints)}")
        coordinates = checked_outputs(with_outputs(mechanism, joints), joints)
    else:
        shown, coordinates = mechanism.independent.tolist(), mechanism
    effort = samples.effort_on(coordinates, [mechanism.joints[i].name for i in shown])
    names = [json.dumps(mechanism.joints[i].name, ensure_ascii=False) for i in shown]
    units = [f"{mechanism.joints[i].name} [{mechanism.joints[i].si_units[0]}]" for i in shown]
    follow = [joint.name for i, joint in enumerate(mechanism.joints) if i not in shown]
    lines = [
        f"# trajectory_msgs/msg/JointTrajectory: plan {json.dumps(samples.plan.problem.name)}, {', '.join(units)}",
        *([f"# the loops give the other joints: {', '.join(follow)}"] if follow else []),
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        '  frame_id: ""',
        f"joint_names: [{', '.join(names)}]",
        "points:",
    ]
    quantities = {
        "positions": samples.q[:, shown],
        "velocities": samples.rates[:, shown] if joints else samples.velocity,
        "accelerations": samples.accelerations()[:, shown] if joints else samples.acceleration,
        "effort": effort,
    }
    for k, time in enumerate(samples.time_s - samples.time_s[0]):
        begins = [f"{name}: [{_numbers(values[k])}]" for name, values in quantities.items()]
        seconds, rest = divmod(round(float(time) * 10**9), 10**9)
        begins.append(f"time_from_start: {{sec: {seconds}, nanosec: {rest}}}")
        lines += [f"  {'-' if first else ' '} {text}" for first, text in zip([True, *[False] * 4], begins, strict=True)]
    return "\n".join(lines) + "\n"


def checked_outputs(outputs: Mechanism, joints: Sequence[str]) -> Mechanism:
    """Return a mechanism whose coordinates are output joints and passive spins.

    Raises:
        ProblemError: if it has other coordinates.
    """
    passive = [outputs.joints[i].name for i in outputs.passive_dofs]
    others = [joint.name for joint in outputs.independent_joints if joint.name not in (*joints, *passive)]
    if others:
        asked = outputs.dof - len(set(passive) - set(joints))
        raise ProblemError(
            f"joints must be {asked}, one for each degree of freedom, got {len(joints)}; {', '.join(others)} would be"
            " omitted"
        )
    return outputs


def _numbers(values: np.ndarray) -> str:
    """Return numbers that YAML 1.1 reads as numbers: it requires a point before an exponent."""
    said = [repr(float(value)) for value in values]
    return ", ".join(text.replace("e", ".0e") if "e" in text and "." not in text else text for text in said)
