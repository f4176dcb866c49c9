"""Sites of `linkplan transfer`: what `check --sites` tells of a pose over the table, and at home ellipses and a polytope.

    p' = A l',   f = g + A^-T u   where the site moves in as many directions as there are coordinates

Motor speeds l' of norm 1 move the site on an ellipse whose semi-axes are the singular values of A; efforts u of norm 1 push
on one with the inverse semi-axes along the same directions (Yoshikawa, Int. J. Robotics Research 4(2), 1985). The forces of
all efforts within their limits, while weight and springs are held, are a polytope with the images of the limits' corners.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from linkplan.models.errors import ProblemError, choose
from linkplan.models.transfer.polytope import MOST_CORNER_MOTORS
from linkplan.models.tree.dynamics import site_names
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, measure
from linkplan.studies.check.site_statics import SiteStatics, site_statics
from linkplan.studies.handover.transfer.study import Transfer
from linkplan.studies.output.document import Axis, Block, Plane, Series, Text, table_of
from linkplan.studies.output.numbers import rounded

_AXES = "xyz"
# A semi-axis below this share of the largest one is rounding: the site does not move in its direction.
_STILL_SHARE = 1e-9
_ELLIPSE_POINTS = 121


class SiteMap(Struct, frozen=True, kw_only=True, eq=False):
    """A site over the n nodes of a table, and at home.

    `directions` (p, 3) are unit vectors, along which `speed_semi_axes_m_s` (p,) are those of the ellipse of motor speeds of
    norm 1 [rad/s or m/s], and `force_semi_axes_n` those of efforts of norm 1 [N.m or N]. `force_vertices_n` (n_v, 3) are the
    forces at the vertices of the polytope, counterclockwise in a plane. Both are None where motors do not determine them.
    """

    site: str
    place_m: np.ndarray  # (3,) at home
    directions: np.ndarray | None
    speed_semi_axes_m_s: np.ndarray | None
    force_semi_axes_n: np.ndarray | None
    held_n: np.ndarray | None  # (3,) the force without effort, due to weight and springs
    force_vertices_n: np.ndarray | None
    least_limit: float  # the smallest effort that every motor has in both directions, the radius of the drawn ellipse
    columns: dict[str, np.ndarray]  # (n,) over the nodes, NaN outside the map

    def figures(self) -> dict[str, Any]:
        """Return the values at home."""
        return {name: getattr(self, name) for name in self.__struct_fields__ if name not in ("site", "columns")}


def site_maps(transfer: Transfer, names: Sequence[str]) -> list[SiteMap]:
    """Return sites of the model over a transfer table.

    Raises:
        ProblemError: for a site that the model lacks.
    """
    outputs, grid = transfer.outputs, transfer.table.grid
    mechanism, limit = outputs.mechanism, np.array(outputs.mechanism.effort_limit)
    if isinstance(names, str):
        raise ProblemError(f"sites must be a list of names, got {names!r}")
    asked = [choose("site", name, site_names(mechanism.model), ProblemError) for name in names]
    if not asked:
        return []
    limit[list(outputs.motors)] = transfer.effort_limit
    known = grid.values["status"].ravel() == 0
    poses = grid.values["pose"].reshape(len(grid.points), -1)[known]
    over, home = (measure(mechanism, q, "the table", limit=limit) for q in (poses, mechanism.home[None]))
    nodes, at_home = ({one.site: one for one in site_statics(path, {})} for path in (over, home))
    return [_site_map(name, nodes[name], at_home[name], home, known) for name in asked]


def _site_map(name: str, nodes: SiteStatics, home: SiteStatics, path: KinematicLoopPath, known: np.ndarray) -> SiteMap:
    actuators = path.mechanism.actuators
    by_motor = set(home.rate) == {one.name for one in actuators}
    rates = np.stack([rate[0] for rate in home.rate.values()], axis=1)  # A (3, n_u)
    ellipse = by_motor and np.isfinite(rates).all()
    U, sizes, _ = np.linalg.svd(rates if ellipse else np.zeros((3, 1)))
    moving = sizes > _STILL_SHARE * max(sizes.max(), np.finfo(float).tiny)
    n = int(moving.sum())
    whole = ellipse and n == len(actuators) == path.mechanism.dof
    directions = U[:, :n].T  # signed so that the largest component is positive
    largest = np.take_along_axis(directions, np.abs(directions).argmax(axis=1)[:, None], axis=1)
    directions = directions * np.where(largest < 0, -1.0, 1.0)
    held = vertices = None
    if whole:
        from_effort = directions.T @ np.linalg.inv((directions @ rates).T)  # (3, n_u)
        hold = np.linalg.solve(path.ratio[0], path.needed[0])
        held = -from_effort @ hold
        if len(actuators) <= MOST_CORNER_MOTORS and np.isfinite(path.limit).all():
            corners = np.array(list(itertools.product(*path.limit)))
            vertices = held + _hull(corners @ from_effort.T @ directions.T) @ directions
    return SiteMap(
        site=name,
        place_m=home.place_m[0],
        directions=directions if ellipse else None,
        speed_semi_axes_m_s=sizes[:n] if ellipse else None,
        force_semi_axes_n=1.0 / sizes[:n] if whole else None,
        held_n=held,
        force_vertices_n=vertices,
        least_limit=float(np.abs(path.limit).min()),
        columns=_columns(name, nodes, known),
    )


def _hull(points: np.ndarray) -> np.ndarray:
    """Return the vertices (n_v, p) of the convex hull of points (n, p), in a plane counterclockwise."""
    if points.shape[1] == 1:
        return np.array([points.min(axis=0), points.max(axis=0)])
    from scipy.spatial import ConvexHull

    return points[ConvexHull(points).vertices]


def _columns(name: str, nodes: SiteStatics, known: np.ndarray) -> dict[str, np.ndarray]:
    """Return a site's columns over all nodes (n,), with NaN where the map is not known."""
    found: dict[str, np.ndarray] = {f"{name}_{axis} [m]": nodes.place_m[:, k] for k, axis in enumerate(_AXES)}
    for k in nodes.axes:
        of = f"{name}_{_AXES[k]}"
        found |= {f"{of}_per_{one} [{nodes.rate_unit[one]}]": rate[:, k] for one, rate in nodes.rate.items()}
        found |= {f"{one}_per_{of} [{nodes.effort_unit[one]}]": x[:, k] for one, x in nodes.effort_per_n.items()}
        found |= {f"{of}_{word}_push [N]": nodes.force_n[:, k, end] for end, word in enumerate(("least", "largest"))}
        found |= {f"{of}_mass [kg]": nodes.mass_kg[:, k], f"{of}_stiffness [N/m]": nodes.stiffness_n_m[:, k]}
    whole = {head: np.full(len(known), np.nan) for head in found}
    for head, values in found.items():
        whole[head][known] = values
    return whole


def site_blocks(found: SiteMap) -> list[Block]:
    """Return a site's ellipses and polytope at home as tables, with their picture if it moves in a plane."""
    if found.directions is None or found.speed_semi_axes_m_s is None:
        return [Text(text=f"site {found.site}: motors do not determine its rates one by one at home", tone="note")]
    if not len(found.directions):
        return [Text(text=f"site {found.site} does not move at home", tone="note")]
    forces = np.full(len(found.directions), np.nan) if found.force_semi_axes_n is None else found.force_semi_axes_n
    rows = [[k + 1, *both, *way] for k, (*both, way) in
            enumerate(zip(found.speed_semi_axes_m_s, forces, found.directions, strict=True))]  # fmt: skip
    heads = ["semi-axis", "per unit of speed [m/s]", "per unit of effort [N]", "x", "y", "z"]
    title = f"Site {found.site} at home: ellipses of motor speeds and of efforts of norm 1"
    blocks: list[Block] = [table_of(title, heads, rows, digits=5)]
    if found.force_vertices_n is not None:
        corners = [[k + 1, *force] for k, force in enumerate(found.force_vertices_n)]
        title = f"Site {found.site} at home: vertices of the forces within the motors' limits, weight and springs held"
        blocks.append(table_of(title, ["vertex", "x [N]", "y [N]", "z [N]"], corners, digits=5))
    return blocks


def site_pictures(maps: Sequence[SiteMap]) -> list[Plane]:
    """Return the pictures of forces and speeds of the sites that move in a plane of two axes of the world."""
    turn = np.linspace(0.0, 2 * np.pi, _ELLIPSE_POINTS)
    circle, found = np.stack([np.cos(turn), np.sin(turn)], axis=1), []
    for one in maps:
        if one.force_vertices_n is None or one.directions is None or one.held_n is None or len(one.directions) != 2:
            continue
        plane = np.flatnonzero(np.abs(one.directions).max(axis=0) > _STILL_SHARE).tolist()
        if len(plane) != 2:
            continue
        forces = one.held_n + one.least_limit * (circle * one.force_semi_axes_n) @ one.directions
        speeds = (circle * one.speed_semi_axes_m_s) @ one.directions
        closed = np.vstack([one.force_vertices_n, one.force_vertices_n[:1]])
        of_forces = [("within the limits", closed, "area", 0), (f"efforts of norm {one.least_limit:.4g}", forces, "line", 1)]
        for title, unit, curves in (
            (f"Forces of site {one.site} at home", "N", of_forces),
            (f"Speeds of site {one.site} at home", "m/s", [("motor speeds of norm 1", speeds, "line", 0)]),
        ):
            x_axis, y_axis = (Axis(label=_AXES[k], unit=unit) for k in plane)
            drawn = [
                Series(name=name, x=rounded(xyz[:, plane[0]]), y=rounded(xyz[:, plane[1]]), look=look, colour=colour)
                for name, xyz, look, colour in curves
            ]
            found.append(Plane(title=title, x_axis=x_axis, y_axis=y_axis, curves=drawn, equal=True))
    return found
