"""A phase plane whose energies have closed forms."""

import numpy as np

from linkplan.planner.phase_plane.grid import PhasePlane


def even_plane(n: int = 401, *, force: float = 0.0, drag: float = 0.0, rub: float = 0.0, top: float = np.inf) -> PhasePlane:
    """Return the plane of 2 kg on the way from 0 to 4 m, under a constant force either way."""
    s = np.linspace(0.0, 4.0, n)
    return PhasePlane(
        s=s,
        cells=np.diff(s),
        inertia=np.full(n, 2.0),
        work={way: way * force * s for way in (+1, -1)},
        force={way: np.full(n, way * force) for way in (+1, -1)},
        drag=np.full(n, -drag),
        rub=np.full(n, rub),
        top={way: np.full(n, top) for way in (+1, -1)},
        effort={way: np.full((2 * n - 1, 1), way * force) for way in (+1, -1)},
    )
