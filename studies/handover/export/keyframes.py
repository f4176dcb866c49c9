"""A plan as keyframes of MuJoCo: a file to include in its model, or the model with them."""

from xml.sax.saxutils import quoteattr

import numpy as np

from linkplan.models.selected_model import whole_model_text
from linkplan.studies.handover.export.samples import ExportedSamples


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


def _numbers(values: np.ndarray | list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
