"""The responses of a plant from chosen inputs to chosen outputs at one pose."""

import numpy as np
from msgspec import UNSET, Struct, UnsetType

from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.studies.feedback.frequency.feedback_loops import OperatingPoint
from linkplan.studies.feedback.frequency.plant_modes import PlantModes
from linkplan.studies.feedback.frequency.response import Response
from linkplan.studies.feedback.frequency.transfer_function import TransferFunction

# Measured gains with a larger uncertainty, as a share of the gain, had not settled; they do not count and are not drawn.
LARGEST_UNCERTAINTY = 0.01


class Root(Struct, frozen=True, kw_only=True):
    """A pole or a zero in the complex plane [rad/s]; of a conjugate pair the one with a positive imaginary part."""

    real_rad_s: float
    imaginary_rad_s: float


class PlantCurve(Struct, frozen=True, kw_only=True, eq=False):
    """A predicted response over frequencies (n,) [Hz]: gain [dB of its unit] and continuous phase [deg]."""

    frequency_hz: np.ndarray
    gain_db: np.ndarray
    phase_deg: np.ndarray


class PlantResponse(PlantModes, frozen=True, kw_only=True, eq=False):
    """The response from one input to one output: poles, zeros and curve of the continuous plant, and its measurement.

    Poles and zeros that cancel are omitted. `integrators` is the number of poles at zero, or minus the number of zeros
    there; `low_frequency_gain` is the limit of s^integrators G, and `gain_at_rest` that of G, None if it is infinite.
    `moves` is False if the input does not move the output at all; there are then no poles, and no curve.
    `right_half_plane_zeros` make it non-minimum-phase. `measured` is compared with `sampled`, the response with hold, delay
    and MuJoCo's steps.
    """

    unit: str
    moves: bool
    integrators: int
    relative_degree: int
    low_frequency_gain: float
    gain_at_rest: float | None
    poles: tuple[Root, ...]
    zeros: tuple[Root, ...]
    unstable_poles: tuple[Root, ...]
    right_half_plane_zeros: tuple[Root, ...]
    curve: PlantCurve | None
    measured: Response | UnsetType = UNSET
    transfer: Beside[TransferFunction] = NOT_READ
    sampled: Beside[PlantCurve | None] = NOT_READ


class PlantPoint(Struct, frozen=True, kw_only=True, eq=False):
    """The plant at one pose; `responses` by "INPUT to OUTPUT".

    `held_by` is the tracker in whose loop it was measured, "itself" for a plant that is stable without one, or None.
    """

    q_deg: dict[str, float]
    q_m: dict[str, float]
    holding_effort: dict[str, float]
    held_by: str | None
    responses: dict[str, PlantResponse]
    point: Beside[OperatingPoint] = NOT_READ
