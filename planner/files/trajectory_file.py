"""A trajectory's file: `trajectory.npz` in a plan's folder.

Members of zip archives are read only up to their declared size, because 8 MB can hold 8 GB of zeros.
"""

import io
import math
import zipfile
from pathlib import Path

import numpy as np

from linkplan.models.errors import PlanFileError, one_line
from linkplan.models.reading import MAX_FILE_BYTES, read_file
from linkplan.planner.keys.kinds import MAX_INTERVALS
from linkplan.planner.trajectory import Trajectory

ARRAYS = ("breaks_s", "position", "velocity", "effort", "start_pose")
# Twice the coefficients of the highest degree: on the largest mesh, more would need gigabytes.
_MAX_COEFFICIENTS = 24


def read_member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Return the bytes of an archive's member.

    Raises:
        ValueError: when it declares more bytes than `max_bytes`, or holds another number of bytes than it declares.
    """
    declared = archive.getinfo(name).file_size
    if declared > max_bytes:
        raise ValueError(f"{name} would take {declared} bytes; at most {max_bytes} are read")
    with archive.open(name) as file:
        content = file.read(declared)
    if len(content) != declared:
        raise ValueError(f"{name} holds {len(content)} bytes and declares {declared}")
    return content


def read_trajectory(path: Path) -> Trajectory:
    """Return the trajectory in a file.

    Raises:
        PlanFileError: when the file is missing, truncated or no trajectory.
    """
    try:
        content = read_file(path, f"'{path}'", MAX_FILE_BYTES, PlanFileError)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            held = archive.namelist()
            lacking = [name for name in (*ARRAYS, "periodic") if f"{name}.npy" not in held]
            if lacking:
                raise PlanFileError(f"'{path}' lacks an array: {lacking[0]}")
            periodic = _array(archive, "periodic", bool)
            if periodic.size != 1:
                raise ValueError(f"periodic is one word, got {periodic.size}")
            arrays = {name: _array(archive, name, float) for name in ARRAYS}
            trajectory = Trajectory(**arrays, periodic=bool(periodic.ravel()[0]))
            n, most = len(trajectory.breaks_s) - 1, max(len(arrays[name]) for name in ("position", "velocity", "effort"))
            if n > MAX_INTERVALS or most > _MAX_COEFFICIENTS:
                raise ValueError(
                    f"it has {n} intervals of {most} coefficients; at most {MAX_INTERVALS} of {_MAX_COEFFICIENTS} are read"
                )
            return trajectory
    except PlanFileError:
        raise
    except Exception as error:  # the parsers of zip files and headers raise some fifteen types on damaged bytes
        why = one_line(error) or type(error).__name__
        raise PlanFileError(f"'{path}' is truncated or not a trajectory: {why}") from error


def _array(archive: zipfile.ZipFile, name: str, wanted: type) -> np.ndarray:
    """Return an array of an npz file.

    Raises:
        ValueError: when it has another type, or its header does not match its length.
    """
    content = read_member(archive, f"{name}.npy", MAX_FILE_BYTES)
    file = io.BytesIO(content)
    version = np.lib.format.read_magic(file)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}.get(version)
    if read_header is None:
        raise ValueError(f"{name} has a header of version {version}")
    shape, fortran, kind = read_header(file)
    if kind != np.dtype(wanted):
        raise ValueError(f"{name} holds {kind}, not {np.dtype(wanted)}")
    size = math.prod(int(length) for length in shape) * kind.itemsize
    if any(length < 0 for length in shape) or size != len(content) - file.tell():
        raise ValueError(f"{name} is of shape {shape}, {size} bytes, and holds {len(content) - file.tell()}")
    return np.frombuffer(content, dtype=kind, offset=file.tell()).reshape(shape, order="F" if fortran else "C")
