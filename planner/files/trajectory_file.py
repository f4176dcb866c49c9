"""A trajectory's file: `trajectory.npz` in a plan's folder."""

import zipfile
import zlib
from pathlib import Path

import numpy as np

from linkplan.models.errors import PlanFileError
from linkplan.planner.trajectory import Trajectory

ARRAYS = ("breaks_s", "position", "velocity", "effort", "start_pose")


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        PlanFileError: when the file is missing, truncated or holds something else.
    """
    try:
        stored = np.load(path, allow_pickle=False)
        if not isinstance(stored, np.lib.npyio.NpzFile):
            raise ValueError("it holds a single array")
        with stored:
            arrays = {name: stored[name] for name in ARRAYS}
            return Trajectory(**arrays, periodic=bool(stored["periodic"]))
    except OSError as error:
        raise PlanFileError(f"'{path}' cannot be read: {error.strerror or 'it is not an npz file'}") from error
    except KeyError as error:
        raise PlanFileError(f"'{path}' lacks an array: {error.args[0]}") from error
    except (zipfile.BadZipFile, zlib.error, ValueError, TypeError, EOFError, IndexError, RuntimeError) as error:
        raise PlanFileError(f"'{path}' is truncated or not a trajectory: {error}") from error
