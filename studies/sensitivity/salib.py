"""SALib, loaded when it is needed: it brings pandas, and is an extra of the installation."""

import importlib
from importlib import metadata
from types import ModuleType

from linkplan.models.errors import LinkplanError


def salib(name: str) -> ModuleType:
    """Return a module of SALib.

    Raises:
        LinkplanError: when it is not installed.
    """
    try:
        return importlib.import_module(f"SALib.{name}")
    except ImportError as error:
        raise LinkplanError(
            "Morris' and Sobol's indices are computed by SALib, which is not installed (pip install"
            " 'linkplan[sensitivity]'); the design 'one-at-a-time' needs nothing more"
        ) from error


def salib_version() -> str:
    """Return SALib's version: where trials lie depends on it.

    Raises:
        LinkplanError: when it is not installed.
    """
    salib("util")
    return metadata.version("SALib")


def unit_cube(d: int) -> dict:
    """Return SALib's description of d factors that lie between 0 and 1."""
    return {"num_vars": d, "names": [str(i) for i in range(d)], "bounds": [[0.0, 1.0]] * d, "groups": None}
