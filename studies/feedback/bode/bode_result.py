"""The loops at the poses of a frequency response, and its additional studies."""

from collections.abc import Sequence

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from linkplan.models.tree.joints import shown_by_unit
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.bode.scan import stability
from linkplan.studies.feedback.frequency.feedback_loops import FeedbackLoop, OperatingPoint
from linkplan.studies.feedback.frequency.floquet import Floquet
from linkplan.studies.feedback.frequency.margins import Margins
from linkplan.studies.feedback.frequency.response import Response
from linkplan.studies.feedback.frequency.stability_map import StabilityMap
from linkplan.studies.feedback.frequency.transfer_function import PlantModes

# Gains simulated in MuJoCo lie this share above and below the stability boundary.
TRIAL_GAIN_SHARE = 0.02


class BodePoint(Margins, frozen=True, kw_only=True, eq=False):
    """The loop of one joint at one pose: its predicted margins, its stability trial in MuJoCo and its measured responses.

    It is a subclass of the sampled loop's margins, so that the JSON has them as keys of the loop. `measured` and `predicted`
    hold the responses of `feedback_loops.QUANTITIES` at the same frequencies, and "plant to JOINT" to each joint that only
    moves along. Both are empty for an unstable loop, and if no measurement was requested. `plant` has the modes of the plant
    to the loop's joint and to those that only move along, where there are any.
    """

    broken_at: str
    settles_in_mujoco: bool
    continuous: Margins
    machine_spectral_radius: float | None = None  # of the loop sampled exactly, without the damping of the simulator's steps
    measured: dict[str, Response] | UnsetType = UNSET
    plant: dict[str, PlantModes] | UnsetType = UNSET
    channel: Beside[int] = NOT_READ
    sampled: Beside[FeedbackLoop] = NOT_READ
    ideal: Beside[FeedbackLoop] = NOT_READ
    predicted: Beside[dict[str, Response]] = NOT_READ

    @property
    def point(self) -> OperatingPoint:
        """The operating point."""
        return self.sampled.point

    @property
    def responses(self) -> dict[str, Response]:
        """The measured responses, if there are any."""
        return self.measured or {}


class PoseLoops(Struct, frozen=True, kw_only=True, eq=False):
    """The loops at one pose by name, the pose, the reduced inertia, a matrix with several coordinates, and the effort."""

    q_deg: dict[str, float]
    q_m: dict[str, float]
    reduced_inertia_kgm2: float | list[list[float]]
    holding_effort: dict[str, float]
    loops: dict[str, BodePoint]


def pose_values(point: OperatingPoint) -> dict[str, dict[str, float]]:
    """Return the joints' positions `q_deg` and `q_m` and the `holding_effort` of a point, each by name."""
    efforts = {a.name: float(u) for a, u in zip(point.mechanism.actuators, point.hold, strict=True)}
    positions = shown_by_unit(point.mechanism.joints, point.pose)
    return {"q_deg": positions["deg"], "q_m": positions["m"], "holding_effort": efforts}


class WorstMargins(Margins, frozen=True, kw_only=True, eq=False):
    """The worst margins over a line, where they are, and the `least` value of each margin with its place."""

    position_deg: float | UnsetType = UNSET
    position_m: float | UnsetType = UNSET
    time_s: float | UnsetType = UNSET
    least: dict[str, dict[str, float]]


class MapStudy(StabilityMap, frozen=True, kw_only=True, eq=False):
    """A stability map about a study's `gains` kp and kd, which are stable up to the longest control period [s].

    `critical_kd`: at each pose the stable kd, `least` to `largest` (null if no kd is too large), at the study's kp, and
    whether MuJoCo settles just below and above the largest. For `as_predicted` of the `tried_count` tried gains, MuJoCo
    agrees with the model. `critical` (n, 2) are the stable kd with NaN if there is none. `longest_period_s` is None if the
    gains are unstable at any period, and infinite if they are stable at any period.
    """

    critical_kd: Sequence[dict[str, float | bool | None]]
    longest_period_s: float | None
    as_predicted: int
    tried_count: int
    gains: Beside[tuple[float, float]] = NOT_READ
    critical: Beside[np.ndarray] = NOT_READ
    settles_near_border: Beside[np.ndarray] = NOT_READ  # (n, 2): MuJoCo settles just below and above the largest stable kd
    longest_at: Beside[OperatingPoint | None] = NOT_READ


class FrozenMargins(Margins, frozen=True, kw_only=True, eq=False):
    """The margins of the worst loop, that of `joint`, at an instant of the motion."""

    time_s: float
    joint: str


class AlongMotion(Struct, frozen=True, kw_only=True, eq=False):
    """A tracker along a plan: frozen margins at instants, the largest frozen pole of all samples, the multipliers.

    The instants are evenly spaced, plus those between them where the margins have a local minimum. `n_loops` is the number
    of coordinates.
    """

    plan: str
    tracker: str
    frozen: tuple[FrozenMargins, ...]
    largest_frozen_pole: float
    floquet: Floquet | None
    n_loops: Beside[int] = NOT_READ

    @property
    def worst(self) -> FrozenMargins:
        """The margins with the smallest disk margin; unstable ones come first."""
        return min(self.frozen, key=stability)
