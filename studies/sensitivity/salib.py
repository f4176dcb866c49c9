"""SALib, an optional dependency, loaded when it is needed because it imports pandas."""

from importlib import metadata
from types import ModuleType

from linkplan.models.extras import load_extra


def salib(name: str) -> ModuleType:
    """Return a module of SALib.

    Raises:
        MissingPackageError: if it is not installed.
    """
    return load_extra(f"SALib.{name}", "Morris' or Sobol's design")


def salib_version() -> str:
    """Return SALib's version, on which the trials depend.

    Raises:
        MissingPackageError: if it is not installed.
    """
    salib("util")
    return metadata.version("SALib")


def unit_cube(d: int) -> dict:
    """Return SALib's description of d factors between 0 and 1."""
    return {"num_vars": d, "names": [str(i) for i in range(d)], "bounds": [[0.0, 1.0]] * d, "groups": None}
