"""Values that users give, as the tables of a problem file have them: numpy's numbers and arrays, tuples, paths."""

from collections.abc import Mapping
from pathlib import PurePath

import numpy as np


def plain(value: object) -> object:
    """Return a value in the types of a TOML file where it has one of them, else as it is: the reader refuses it by name."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return value.item()
    return str(value) if isinstance(value, PurePath) else value
