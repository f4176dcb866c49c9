"""Optional packages: each is loaded at its first use, with a one-line error if it is missing."""

import importlib
from types import ModuleType

from linkplan.models.errors import MissingPackageError

# The package that has a module and the extra of linkplan that installs it: [project.optional-dependencies].
EXTRAS = {
    "av": ("PyAV", "video"),
    "distributed": ("Dask", "cluster"),
    "pandas": ("pandas", "pandas"),
    "pyarrow": ("pyarrow", "parquet"),
    "xarray": ("xarray", "xarray"),
    "yaml": ("PyYAML", "urdf"),
}


def load_extra(module: str, feature: str) -> ModuleType:
    """Return a module of an optional package.

    Args:
        module: its full name, such as "pyarrow.parquet".
        feature: what needs it, the subject of a sentence.

    Raises:
        MissingPackageError: if the package is not installed.
    """
    root = module.partition(".")[0]
    package, extra = EXTRAS[root]
    try:
        importlib.import_module(root)
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingPackageError(
            f"{feature} needs {package}, which is not installed: pip install 'linkplan[{extra}]'"
        ) from error
