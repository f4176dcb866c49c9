"""Old names of public fields, which stay readable until the next major version."""

import warnings
from collections.abc import Mapping
from typing import ClassVar


class RenamedFields:
    """A base of classes whose fields were renamed: an old name returns the new one's value, with a DeprecationWarning."""

    __slots__ = ()
    renamed: ClassVar[Mapping[str, str]] = {}

    def __getattr__(self, name: str) -> object:
        """Return the value of the field that was called `name`.

        Raises:
            AttributeError: if no field ever had this name.
        """
        kind = type(self)
        if name not in kind.renamed:
            raise AttributeError(f"'{kind.__name__}' has no attribute '{name}'")
        new = kind.renamed[name]
        warnings.warn(f"{kind.__name__}.{name} is called {new}", DeprecationWarning, stacklevel=2)
        return getattr(self, new)
