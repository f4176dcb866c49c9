"""A plan's export: the content of one file."""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from msgspec import Struct

from linkplan.models.errors import LinkplanError, ProblemError, choose
from linkplan.planner.files.columns import csv_bytes, parquet_bytes
from linkplan.planner.plan.plan import Plan
from linkplan.studies.handover.export.formats import FORMATS
from linkplan.studies.handover.export.keyframes import keyframes_text, model_with_keyframes_text
from linkplan.studies.handover.export.matlab import mat_bytes
from linkplan.studies.handover.export.ros import joint_trajectory_text
from linkplan.studies.handover.export.samples import ExportedSamples, exported_samples
from linkplan.studies.output.document import Block, Text


class FileRecord(Struct, frozen=True, kw_only=True):
    """What was written to a file: its format, its size [byte] and the name of the plan's problem."""

    file: str
    format: str
    bytes: int
    plan: str

    def blocks(self, target: Path) -> list[Block]:
        """Return the record of a file as a document's blocks."""
        return [Text(text=f"{target}: {self.plan}, {FORMATS[self.format]}")]


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


_WRITERS: Mapping[str, Callable[[ExportedSamples], bytes]] = {
    "keyframes": lambda samples: keyframes_text(samples).encode("utf-8"),
    "mjcf": lambda samples: model_with_keyframes_text(samples).encode("utf-8"),
    "ros": lambda samples: joint_trajectory_text(samples).encode("utf-8"),
    "mat": mat_bytes,
    "csv": lambda samples: csv_bytes(samples.table.columns()),
    "parquet": lambda samples: parquet_bytes(samples.table.columns(), about(samples.plan)),
}
