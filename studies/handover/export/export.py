"""A plan's export: the content of one file, of keyframes of MuJoCo, a trajectory of ROS, a MATLAB file or a table."""

import io
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from xml.sax.saxutils import quoteattr

import numpy as np
import scipy.io

from linkplan.models.errors import LinkplanError, ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.selected_model import whole_model_text
from linkplan.planner.files.columns import csv_bytes, parquet_bytes
from linkplan.planner.plan.plan import Plan
from linkplan.studies.handover.export.exported import Exported
from linkplan.studies.handover.export.formats import FORMATS
from linkplan.studies.handover.export.output_joints import with_outputs
from linkplan.studies.handover.export.samples import ExportedSamples, exported_samples
from linkplan.studies.output.document import Block, Text


class FileRecord(Exported, frozen=True, kw_only=True):
    """What was written to a file: its format, its size [byte] and the name of the plan's problem."""

    file: str
    format: str
    bytes: int
    plan: str

    def blocks(self) -> list[Block]:
        """Return the record of a file as a document's blocks."""
        return [Text(text=f"{self.path}: {self.plan}, {FORMATS[self.format]}")]


def exported(plan: Plan, to: str, every_s: float | None = None, joints: Sequence[str] = ()) -> bytes:
    """Return a plan as the content of a file.

    Args:
        plan: with a motion.
        to: one of `FORMATS`.
        every_s: the time between samples [s]; by default there are ten in each interval of the plan's mesh.
        joints: output joints of a trajectory for ROS; by default the independent joints.

    Raises:
        LinkplanError: if the plan has no motion, the format is unknown, or the time between samples is invalid.
    """
    choose("format", to, FORMATS, ProblemError)
    if plan.trajectory is None:
        raise LinkplanError(f"cannot export: the plan has no motion: {plan.message}")
    if joints and to != "ros":
        raise ProblemError(f"joints applies to the format ros only, got {to}")
    samples = exported_samples(plan, every_s)
    return joint_trajectory_text(samples, joints).encode("utf-8") if joints else _WRITERS[to](samples)


def about(plan: Plan) -> dict[str, str]:
    """Return the metadata on a plan for a file."""
    return {"linkplan": version("linkplan"), "plan": plan.problem.name, "mechanism": plan.problem.mechanism.name}


def keyframes_text(samples: ExportedSamples) -> str:
    """Return an MJCF file of one <keyframe>: time, qpos, qvel and ctrl at each sample, exact to the last digit.

    Include it in the model, or in a file that includes the model first: <include file="..."/>.
    """
    problem = samples.plan.problem
    about = f"{len(samples.time_s)} samples of the plan '{problem.name}' of mechanism '{problem.mechanism.name}'"
    return f"<mujoco>\n  <!-- {about.replace('--', '- -')} -->\n{_keyframe(samples)}</mujoco>\n"


def model_with_keyframes_text(samples: ExportedSamples) -> str:
    """Return the model's MJCF with the plan's payload and softness, and with the keyframes."""
    head, end, _ = whole_model_text(samples.plan.problem.mechanism).rpartition("</mujoco>")
    return f"{head}{_keyframe(samples)}{end}\n"


def _keyframe(samples: ExportedSamples) -> str:
    name, lines = samples.plan.problem.name, ["  <keyframe>"]
    width = len(str(len(samples.time_s) - 1))
    rows = zip(samples.time_s - samples.time_s[0], samples.qpos(), samples.qvel(), samples.ctrl(), strict=True)
    for k, (time, qpos, qvel, ctrl) in enumerate(rows):
        values = {"name": f"{name} {k:0{width}d}", "time": _numbers([time]), "qpos": _numbers(qpos), "qvel": _numbers(qvel)}
        if len(ctrl):
            values["ctrl"] = _numbers(ctrl)
        lines.append("    <key " + " ".join(f"{key}={quoteattr(value)}" for key, value in values.items()) + "/>")
    return "\n".join([*lines, "  </keyframe>", ""])


def mat_bytes(samples: ExportedSamples) -> bytes:
    """Return a MATLAB 5 file: time_s (n, 1), and structs position, speed, acceleration, effort, site, body by name.

    `units` has the same structs with a unit for each name, `names` has the names of the model.
    """
    table = samples.table
    content: dict = {"time_s": table.time_s, "plan": samples.plan.problem.name}
    units: dict = {"time_s": "s"}
    names: dict = {}
    for group, rows in table.by_quantity().items():
        if rows:
            fields = _fields(rows)
            content[group] = {fields[name]: values for name, (_, values) in rows.items()}
            units[group] = {fields[name]: unit for name, (unit, _) in rows.items()}
            names[group] = {field: name for name, field in fields.items()}
    file = io.BytesIO()
    scipy.io.savemat(file, content | {"units": units, "names": names}, long_field_names=True, oned_as="column")
    return file.getvalue()


def _fields(names: Iterable[str]) -> dict[str, str]:
    """Return a unique MATLAB field name for each name: letters, digits and _, starting with a letter.

    MATLAB's format keeps 63 characters of a field name; four of them are for a number.
    """
    fields: dict[str, str] = {}
    for name in names:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", name)
        plain = (plain if plain[:1].isalpha() else f"x{plain}")[:59]
        field, number = plain, 1
        while field in fields.values():
            number += 1
            field = f"{plain}_{number}"
        fields[name] = field
    return fields


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
        begins = [f"{name}: [{_numbers(values[k], ', ')}]" for name, values in quantities.items()]
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


def _numbers(values: np.ndarray | list[float], between: str = " ") -> str:
    """Return numbers that YAML 1.1 reads as numbers, too: it requires a point before an exponent."""
    texts = [repr(float(value)) for value in values]
    return between.join(text.replace("e", ".0e") if "e" in text and "." not in text else text for text in texts)


_WRITERS: Mapping[str, Callable[[ExportedSamples], bytes]] = {
    "keyframes": lambda samples: keyframes_text(samples).encode("utf-8"),
    "mjcf": lambda samples: model_with_keyframes_text(samples).encode("utf-8"),
    "ros": lambda samples: joint_trajectory_text(samples).encode("utf-8"),
    "mat": mat_bytes,
    "csv": lambda samples: csv_bytes(samples.table.columns()),
    "parquet": lambda samples: parquet_bytes(samples.table.columns(), about(samples.plan)),
}
