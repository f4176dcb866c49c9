"""The quantities of a study: names and unit of each, once for records, tables and plots."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Quantity:
    """A quantity: a `field` (n, ...) with an axis for each kind of part in `of`, symmetric if two axes are of one kind.

    `unit` is a text, or a function of the parts. Names contain the parts in braces. A quantity without `column` is not in
    the table; a quantity without a title in `plot` is not plotted. `label` names the plot's axis, `line` a line in it.
    `meaning` is a phrase on the quantity.
    """

    field: str
    of: tuple[str, ...] = ()
    unit: str | Callable[..., str] = "1"
    column: str = ""
    plot: str = ""
    label: str = ""
    line: str = "{}"
    meaning: str = ""


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Curve:
    """One curve of a quantity: the names of its parts, its unit, and its values (n,) or intervals (n, 2)."""

    names: tuple[str, ...]
    unit: str
    values: np.ndarray


def curves_of(quantity: Quantity, parts: Mapping[str, Sequence[tuple[int, Any]]], values: np.ndarray) -> Iterator[Curve]:
    """Yield the curves of a quantity with values (n, ...), of a symmetric one those of the upper triangle.

    `parts` has those of each kind, each with its index: what has a name and is given to `unit`, or the name itself.
    """
    symmetric = len(quantity.of) > 1 and quantity.of[0] == quantity.of[1]
    for some in itertools.product(*(parts[kind] for kind in quantity.of)):
        index, things = tuple(k for k, _ in some), [thing for _, thing in some]
        if symmetric and index[1] < index[0]:
            continue
        unit = quantity.unit if isinstance(quantity.unit, str) else quantity.unit(*things)
        names = tuple(thing if isinstance(thing, str) else thing.name for thing in things)
        yield Curve(names=names, unit=unit, values=values[(slice(None), *index)])
