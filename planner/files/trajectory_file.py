"""A trajectory's file: `trajectory.npz` in a plan's folder."""

import io
import math
import zipfile
from pathlib import Path

import numpy as np

from linkplan.models.errors import PlanFileError, one_line
from linkplan.models.reading import read_file
from linkplan.planner.trajectory import Trajectory

ARRAYS = ("breaks_s", "position", "velocity", "effort", "start_pose")
# The largest mesh, in its highest degree, for a mechanism of forty joints: 20,000 intervals x 10 x 40 x 8 bytes.
_MOST_BYTES = 64_000_000


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        PlanFileError: when the file is missing, truncated or holds something else.
    """
    try:
        content = read_file(path, f"'{path}'", _MOST_BYTES, PlanFileError)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            held = archive.namelist()
            lacking = [name for name in (*ARRAYS, "periodic") if f"{name}.npy" not in held]
            if lacking:
                raise PlanFileError(f"'{path}' lacks an array: {lacking[0]}")
            arrays = {name: _array(archive, name) for name in ARRAYS}
            periodic = _array(archive, "periodic")
            if periodic.size != 1:
                raise ValueError(f"periodic is one word, got {periodic.size}")
            return Trajectory(**arrays, periodic=bool(periodic.ravel()[0]))
    except PlanFileError:
        raise
    except Exception as error:  # a zip file's and a header's parsers raise some fifteen kinds on damaged bytes
        why = one_line(error) or type(error).__name__
        raise PlanFileError(f"'{path}' is truncated or not a trajectory: {why}") from error


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Return an array of an npz file, whose size is looked at before it is asked for: 8 MB can hold 8 GB of zeros.

    Raises:
        ValueError: when it is not numbers, or its header and its length do not agree.
    """
    declared = archive.getinfo(f"{name}.npy").file_size
    if declared > _MOST_BYTES:
        raise ValueError(f"{name} would take {declared} bytes; at most {_MOST_BYTES} are read")
    with archive.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
        if read_header is None:
            raise ValueError(f"{name} has a header of version {version}")
        shape, fortran, kind = read_header(file)
        if kind.kind not in "biuf" or kind.hasobject:
            raise ValueError(f"{name} holds {kind}, not numbers")
        wanted = math.prod(int(size) for size in shape) * kind.itemsize
        if any(size < 0 for size in shape) or wanted != declared - file.tell():
            raise ValueError(f"{name} is of shape {shape}, {wanted} bytes, and holds {declared - file.tell()}")
        data = np.frombuffer(file.read(), dtype=kind)
    return data.reshape(shape, order="F" if fortran else "C")
