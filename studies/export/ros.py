"""A plan as a joint trajectory of ROS: the message trajectory_msgs/JointTrajectory as YAML."""

import json

import numpy as np

from linkplan.studies.export.samples import Samples


def joint_trajectory_text(samples: Samples) -> str:
    """Return the YAML of a trajectory_msgs/msg/JointTrajectory: the independent joints, in radians or metres.

    `effort` of a joint is the actuators' effort on that coordinate, Gamma^T B u [N.m or N]. For a motor on the joint it is
    its torque times its gear.
    """
    mechanism = samples.plan.problem.mechanism
    names = [json.dumps(joint.name, ensure_ascii=False) for joint in mechanism.independent_joints]
    units = [f"{joint.name} [{'rad' if joint.kind == 'hinge' else 'm'}]" for joint in mechanism.independent_joints]
    follow = [mechanism.joints[int(index)].name for index in mechanism.dependent]
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
        "positions": samples.position,
        "velocities": samples.velocity,
        "accelerations": samples.acceleration,
        "effort": samples.generalised_effort(),
    }
    for k, time in enumerate(samples.time_s - samples.time_s[0]):
        begins = [f"{name}: [{_numbers(values[k])}]" for name, values in quantities.items()]
        seconds, rest = divmod(round(float(time) * 10**9), 10**9)
        begins.append(f"time_from_start: {{sec: {seconds}, nanosec: {rest}}}")
        lines += [f"  {'-' if first else ' '} {text}" for first, text in zip([True, *[False] * 4], begins, strict=True)]
    return "\n".join(lines) + "\n"


def _numbers(values: np.ndarray) -> str:
    """Return numbers that YAML 1.1 reads as numbers: it requires a point before an exponent."""
    said = [repr(float(value)) for value in values]
    return ", ".join(text.replace("e", ".0e") if "e" in text and "." not in text else text for text in said)
