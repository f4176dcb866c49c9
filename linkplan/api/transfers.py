"""`transfer`: efforts, inertia, friction and gains converted between motors and output joints of a linkage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from linkplan.api.command import command
from linkplan.api.inputs import PlanLike, Subject, numbers, plan_of, subject_of
from linkplan.api.reporting import Progress, listener
from linkplan.models.errors import ProblemError
from linkplan.planner.problem.settings import to_toml_types
from linkplan.studies.handover.transfer.study import transfer_study
from linkplan.studies.handover.transfer.transfer_result import TransferResult, transfer_result

Gains = float | Sequence[float]


@command(
    "convert efforts, inertia, friction and gains between motors and output joints of a linkage, as tables",
    saved=True,
    showing=("report", "parquet"),
)
def transfer(
    subject: Subject,
    joints: Sequence[str],
    *,
    tolerance: float = 1e-3,
    range_deg: Mapping[str, Sequence[float]] | None = None,
    range_m: Mapping[str, Sequence[float]] | None = None,
    motor_speed: Gains | None = None,
    joint_kp: Gains | None = None,
    joint_kd: Gains | None = None,
    motor_kp: Gains | None = None,
    motor_kd: Gains | None = None,
    along: PlanLike | None = None,
    sites: Sequence[str] = (),
    progress: Progress | None = None,
) -> TransferResult:
    """Return the transfer table of output joints, which relates motors and joints of a linkage.

    Motor velocity = G joint velocity, joint effort = G^T motor effort, so motor power equals joint power. A motor's
    position is its gear times its joint's position, as MuJoCo's actuator length. Radians, metres and SI units throughout.

    Args:
        subject: a mechanism, a `Problem`, or the name or path of either, in any coordinates. A problem gives the effort
            limits and the motors' top speeds.
        joints: one to three output joints, which determine the motors. Other independent coordinates rest at home.
        tolerance: the allowed error of linear interpolation in the table, as a share of each quantity's largest value.
        range_deg: [low, high] [deg] of an output hinge; by default its whole reach.
        range_m: likewise, of a slide [m].
        motor_speed: the motors' top speeds [rad/s or m/s], one for all or one each.
        joint_kp: joints' stiffness [N.m/rad or N/m] to convert to the motors, one for all or one each.
        joint_kd: joints' damping [N.m.s/rad or N.s/m], likewise.
        motor_kp: motors' stiffness to convert to the joints.
        motor_kd: motors' damping, likewise.
        along: a plan of the same model, or its path; the errors of models without loops are computed along its motion.
        sites: sites whose rates, pushes, mass and stiffness are columns of the table, with the ellipses of their speeds and
            forces and the polytope of their forces at home.
        progress: called with lines on the progress.

    Raises:
        LinkplanError: if the joints cannot be coordinates at home, for example at a dead centre, or a value is invalid.

    Example::

        table = linkplan.transfer("optimus-knee", ["C"])
        print(table.message)
    """
    if isinstance(joints, str) or not isinstance(joints, Sequence) or not all(isinstance(name, str) for name in joints):
        raise ProblemError(f"joints must be a list of names, got {joints!r}")
    mechanism, problem = subject_of(subject)
    say = listener(progress)
    gains = {"joint_kp": joint_kp, "joint_kd": joint_kd, "motor_kp": motor_kp, "motor_kd": motor_kd}
    ends = {}
    for key, table in (("range_deg", range_deg), ("range_m", range_m)):
        if not isinstance(table, Mapping | None):
            raise ProblemError(f"{key} must be a table of joint = [low, high], got {table!r}")
        for name, both in to_toml_types(table or {}).items():
            joint = mechanism.joints[mechanism.joint_index(name, ProblemError)]
            values = numbers(both, f"{key}.{name}")
            if len(values) != 2 or joint.unit != key.removeprefix("range_"):
                raise ProblemError(f"{key}.{name} must be [low, high] of a joint in {joint.unit}, got {both!r}")
            ends[name] = (joint.read(values[0]), joint.read(values[1]))
    found = transfer_study(
        mechanism,
        list(joints),
        tolerance=tolerance,
        ends=ends,
        problem=problem,
        motor_speeds=() if motor_speed is None else numbers(motor_speed, "motor_speed"),
        along=None if along is None else plan_of(along, say, "compare with"),
        gains={name: numbers(values, name) for name, values in gains.items() if values is not None},
        say=say,
    )
    return transfer_result(found, sites)
