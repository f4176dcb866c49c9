"""The colours of bodies, the same in figures, pages and films: a model's own, otherwise those of a series."""

import mujoco
import numpy as np
from matplotlib.colors import to_hex, to_rgba

from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.solids import visible_geoms
from linkplan.studies.output.figure import SERIES

# More than the seven colours of lines, because bodies also differ in shape. The page has the same (`BODY_COLOURS`).
BODY_SERIES = (*SERIES, "#5b6ee1", "#8a9a00", "#c0392b")
PAYLOAD = to_rgba("#8d8273")  # the page has the same (`--payload`)
_GROUND = (0.35, 0.35, 0.35, 1.0)


def plain_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return the mask (n_geom,) of moving geoms without a colour: MuJoCo's default grey, and no material."""
    grey = np.all(np.isclose(model.geom_rgba, (0.5, 0.5, 0.5, 1.0)), axis=1)
    return grey & (model.geom_matid < 0) & (model.body_weldid[model.geom_bodyid] != 0)


def body_colours(mechanism: Mechanism) -> dict[int, tuple[float, ...]]:
    """Return the rgba of each body: that of its first visible coloured geom, otherwise from a series; the ground is grey.

    Bodies that are welded together have the same colour.
    """
    model = mechanism.model
    coloured = visible_geoms(model) & ~plain_geoms(model) & (model.geom_matid < 0)
    colours: dict[int, tuple[float, ...]] = {0: _GROUND}
    moving = 0
    for body in range(1, model.nbody):
        root = int(model.body_weldid[body])
        if root != body:
            colours[body] = colours[root]
            continue
        own = np.flatnonzero((model.body_weldid[model.geom_bodyid] == body) & coloured)
        colours[body] = (
            (*map(float, model.geom_rgba[own[0], :3]), 1.0) if len(own) else to_rgba(BODY_SERIES[moving % len(BODY_SERIES)])
        )
        moving += 1
    return colours


def colour_name(rgba: tuple[float, ...]) -> str:
    """Return a colour for a page: "c0" to "c9" of its series (which depends on dark mode), otherwise "#rrggbb"."""
    for k, one in enumerate(BODY_SERIES):
        if np.abs(np.subtract(rgba[:3], to_rgba(one)[:3])).max() < 0.02:
            return f"c{k}"
    return hex_of(rgba)


def hex_of(rgba: tuple[float, ...]) -> str:
    """Return a colour as "#rrggbb"."""
    red, green, blue = rgba[:3]
    return to_hex((red, green, blue))
