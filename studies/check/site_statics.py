"""What a site does for an effort, and an effort for a site: rates, forces, reflected mass and stiffness at rest.

    p' = J v,   r u = h + J^T f

p (3,) is the site's position, v the rates of the independent coordinates, r = Gamma^T B, u the actuators' efforts, h what
weight and springs need at rest, and f (3,) the force with which the site pushes on its surroundings: virtual work. Along an
axis e of the world the site has the mass 1 / (e^T J M^-1 J^T e) (Khatib, IEEE J. Robotics and Automation 3, 1987) and the
stiffness 1 / (e^T J K^-1 J^T e), where K = d(h - r u) / ds is that of springs and weight under constant efforts: the wheel
rate of a suspension.
"""

import functools
from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np
from msgspec import UNSET, Struct, UnsetType

from linkplan.models.actuation.distribution import lacking, unit_efforts
from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import distributed, sampled, site_motion
from linkplan.models.reduction.reduced import ReducedDynamics
from linkplan.models.transfer.polytope import inverse_ratios
from linkplan.models.tree.dynamics import site_names
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath, reflected
from linkplan.studies.output.document import Axis, Block, Plot, Table, Text, table_of
from linkplan.studies.output.lines import Line, plots

_AXES = "xyz"
# A stiffness below this share of the largest coordinate's is none: the site moves freely to rounding.
_FREE_SHARE = 1e-9


class SiteStatics(Struct, frozen=True, kw_only=True, eq=False):
    """A site along a path of n poses at rest; the axes are those of the world.

    Rates are by actuator where each actuator drives the site alone or with as many others as there are coordinates, and by
    coordinate elsewhere, where actuators cannot move one by one. Efforts are in the actuator's unit, N.m or N.
    """

    path: str
    site: str
    position: dict[str, np.ndarray]  # (n,) of the independent coordinates [deg or m]
    units: dict[str, str]  # of the positions
    place_m: np.ndarray  # (n, 3)
    rate: dict[str, np.ndarray]  # (n, 3) [m per rad, or m per m]
    effort_per_n: dict[str, np.ndarray]  # (n, 3) effort with which the site pushes with one newton more along an axis
    rate_unit: dict[str, str]
    effort_unit: dict[str, str]  # of an effort per newton
    force_n: np.ndarray  # (n, 3, 2) least and largest push within the actuators' limits while weight and springs are held
    mass_kg: np.ndarray  # (n, 3), nan where the inertia is singular
    stiffness_n_m: np.ndarray  # (n, 3) of springs and weight under constant efforts; 0 if the site moves freely
    given_force_n: np.ndarray | UnsetType = UNSET  # (3,) that acts on the machine at the site
    given_effort: dict[str, np.ndarray] | UnsetType = UNSET  # (n,) with which the actuators hold weight, springs and force
    missed: dict[str, np.ndarray] | UnsetType = UNSET  # (n,) generalised effort that their limits lack, by coordinate

    @property
    def axes(self) -> list[int]:
        """The axes of the world along which the site moves on some pose of the path."""
        sizes = np.nanmax([np.abs(rate) for rate in self.rate.values()], axis=(0, 1), initial=0.0)
        return [k for k in range(3) if sizes[k] > ROUNDING_SHARE * sizes.max(initial=0.0) > 0]


def checked_forces(mechanism: Mechanism, forces: Mapping[str, Sequence[float]]) -> dict[str, np.ndarray]:
    """Return forces [N] on sites as arrays (3,).

    Raises:
        ProblemError: for a site that the model lacks, or a force that is not three finite numbers.
    """
    known, found = site_names(mechanism.model), {}
    for name, force in forces.items():
        if name not in known:
            sites = ", ".join(known) or "none"
            raise ProblemError(f"site_force_n names sites of the model ({sites}), got '{name}'")
        value = np.asarray(force, dtype=float)
        if value.shape != (3,) or not np.isfinite(value).all():
            raise ProblemError(f"site_force_n of '{name}' must be three finite numbers x, y, z [N], got {force!r}")
        found[name] = value
    return found


def site_statics(path: KinematicLoopPath, forces: Mapping[str, np.ndarray]) -> Iterator[SiteStatics]:
    """Yield the statics of each site along a path; `forces` (3,) [N] act on the machine at some sites, one at a time."""
    mechanism, n = path.mechanism, len(path.poses)
    still = np.zeros((n, mechanism.dof))
    of_units = [
        sampled(site_motion(mechanism, 1), path.poses, still + unit, still) for unit in np.eye(mechanism.dof)
    ]  # each (n, 3, n_sites)
    hold = np.einsum("ksu,ku->ks", path.ratio, path.holding_effort) + path.unheld_effort
    stiffness = sampled(_stiffness(mechanism.dynamics), path.poses, path.holding_effort)
    names = [joint.name for joint in mechanism.independent_joints]
    back = inverse_ratios(path.ratio) if mechanism.n_u == mechanism.dof else None  # (n, n_u, n_s)
    for name in site_names(mechanism.model):
        k = int(mechanism.model.site(name).id)
        J = np.stack([rates[:, :, k] for rates in of_units], axis=2)  # (n, 3, n_s)
        J = np.where(np.abs(J) > ROUNDING_SHARE * np.abs(J).max(initial=0.0), J, 0.0)
        if back is not None:
            by, kinds = [actuator.name for actuator in mechanism.actuators], [a.unit for a in mechanism.actuators]
            rate = np.einsum("kas,kus->kua", J, back)
        else:
            by, kinds, rate = names, [joint.si_units[1] for joint in mechanism.independent_joints], J.transpose(0, 2, 1)
        # The efforts of least norm (n, n_u, 3) that balance a unit of force; NaN where none does.
        per_n = unit_efforts(path.ratio) @ J.transpose(0, 2, 1)
        missed, sizes = np.abs(path.ratio @ per_n - J.transpose(0, 2, 1)).max(axis=1), np.abs(J).max(axis=2)
        per_n = np.where((missed <= 1e-9 * (sizes + sizes.max(initial=0.0)))[:, None, :], per_n, np.nan)
        force = forces.get(name)
        further = {} if force is None else _under(path, J, hold, force)
        yield SiteStatics(
            path=path.title,
            site=name,
            position={
                joint.name: joint.shown(x) for joint, x in zip(mechanism.independent_joints, path.positions.T, strict=True)
            },
            units={joint.name: joint.unit for joint in mechanism.independent_joints},
            place_m=path.places[:, :, k],
            rate=_without_rounding({one: rate[:, i] for i, one in enumerate(by)}),
            rate_unit={one: "m/rad" if kind == "N.m" else "m/m" for one, kind in zip(by, kinds, strict=True)},
            effort_per_n=_without_rounding({a.name: per_n[:, j] for j, a in enumerate(mechanism.actuators)}),
            effort_unit={a.name: f"{a.unit}/N" for a in mechanism.actuators},
            force_n=_pushes(path, J, hold, back),
            mass_kg=reflected(J.transpose(0, 2, 1), path.reduced_inertia),
            stiffness_n_m=_stiffness_at(J, stiffness),
            **further,
        )


def _pushes(path: KinematicLoopPath, J: np.ndarray, hold: np.ndarray, back: np.ndarray | None) -> np.ndarray:
    """Return the least and the largest force (n, 3, 2) [N] with which the site can push along each axis alone."""
    n, low_high = len(J), path.limit
    found = np.full((n, 3, 2), np.nan)
    if back is not None:
        at_none = np.einsum("kus,ks->ku", back, hold)
        with np.errstate(all="ignore"):
            for axis in range(3):
                by = np.einsum("kus,ks->ku", back, J[:, axis])
                by = np.where(np.abs(by) > ROUNDING_SHARE * np.abs(by).max(initial=0.0), by, 0.0)
                ends = (low_high[None] - at_none[:, :, None]) / by[:, :, None]
                least, most = np.nanmax(ends.min(axis=2), axis=1), np.nanmin(ends.max(axis=2), axis=1)
                moves = np.abs(by).max(axis=1) > 0
                found[:, axis] = np.where((moves & (least <= most))[:, None], np.stack([least, most], axis=1), np.nan)
        return found
    import scipy

    bounds = [*low_high.tolist(), (None, None)]
    bounds = [tuple(None if x is None or not np.isfinite(x) else x for x in pair) for pair in bounds]
    cost = np.append(np.zeros(path.ratio.shape[2]), 1.0)
    for k, axis in np.ndindex(n, 3):
        if np.abs(J[k, axis]).max() <= ROUNDING_SHARE * np.abs(J).max(initial=0.0):
            continue
        rows = np.hstack([path.ratio[k], -J[k, axis][:, None]])
        for end, sign in ((0, 1.0), (1, -1.0)):
            answer = scipy.optimize.linprog(sign * cost, A_eq=rows, b_eq=hold[k], bounds=bounds)
            found[k, axis, end] = answer.x[-1] if answer.status == 0 else -sign * np.inf if answer.status == 3 else np.nan
    return found


@functools.lru_cache(maxsize=16)
def _stiffness(dynamics: ReducedDynamics) -> ca.Function:
    """Return the function from q and u to the stiffness d(h - r u) / ds (n_s, n_s) of the coordinates at rest."""
    residual = dynamics.residual
    q, u = ca.SX.sym("q", residual.size1_in(0)), ca.SX.sym("u", residual.size1_in(3))
    still = ca.SX.zeros(residual.size1_in(1))
    return ca.Function(
        "stiffness", [q, u], [ca.densify(ca.jacobian(residual(q, still, still, u), q) @ dynamics.velocity_map(q))]
    )


def _stiffness_at(J: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Return the stiffness (n, 3) [N/m] at a site along each axis; 0 where it moves without any, inf where it is still."""
    found = np.zeros(J.shape[:2])
    largest = np.abs(stiffness).max(initial=0.0)
    for k, K in enumerate(stiffness):
        if np.abs(K).max() <= _FREE_SHARE * largest or not np.isfinite(K).all():
            continue
        moved = np.linalg.pinv(K, rcond=_FREE_SHARE) @ J[k].T  # of the coordinates, by a unit force
        carried = np.abs(K @ moved - J[k].T).max(axis=0) <= 1e-6 * np.abs(J[k]).max(axis=1)
        compliance = np.einsum("as,sa->a", J[k], moved)
        with np.errstate(divide="ignore"):
            found[k] = np.where(carried, 1.0 / compliance, 0.0)
    return found


def _under(path: KinematicLoopPath, J: np.ndarray, hold: np.ndarray, force: np.ndarray) -> dict:
    """Return the fields of `SiteStatics` on a force (3,) that acts on the machine at the site."""
    tau = hold - np.einsum("kas,a->ks", J, force)
    effort = distributed(path.mechanism, tau, path.ratio, path.limit)
    missed = np.abs(lacking(tau, path.ratio, effort, path.limit))
    return {
        "given_force_n": force,
        "given_effort": {a.name: effort[:, j] for j, a in enumerate(path.mechanism.actuators)},
        "missed": {joint.name: missed[:, k] for k, joint in enumerate(path.mechanism.independent_joints)},
    }


def statics_blocks(found: SiteStatics) -> list[Block]:
    """Return the tables of a site along a path at nine poses: rates and efforts, then forces, mass and stiffness."""
    axes = found.axes
    if not axes:
        return [Text(text=f"site {found.site} does not move along {found.path}", tone="note")]
    n = len(found.place_m)
    at = np.unique(np.linspace(0, n - 1, num=9).astype(int))
    moved = [name for name, x in found.position.items() if n == 1 or np.ptp(x) > 0] or list(found.position)
    where: list[tuple[str, str, np.ndarray]] = [(name, found.units[name], found.position[name]) for name in moved]
    per = [(f"{_AXES[k]} per {name}", found.rate_unit[name], found.rate[name][:, k]) for name in found.rate for k in axes]
    per += [
        (f"{name} per N {_AXES[k]}", found.effort_unit[name].removesuffix("/N"), values[:, k])
        for name, values in found.effort_per_n.items()
        for k in axes
    ]
    felt: list[tuple[str, str, np.ndarray]] = []
    for k in axes:
        felt += [(f"{word} {_AXES[k]}", "N", found.force_n[:, k, end]) for end, word in enumerate(("least", "most"))]
    felt += [(f"mass {_AXES[k]}", "kg", found.mass_kg[:, k]) for k in axes]
    felt += [(f"stiffness {_AXES[k]}", "N/m", found.stiffness_n_m[:, k]) for k in axes if np.any(found.stiffness_n_m[:, k])]
    shown = f"({len(at)} of {n} poses)"
    blocks: list[Block] = [
        _table(f"Site {found.site} along {found.path}, at rest {shown}", [*where, *per], at),
        _table(f"Pushes of site {found.site} within the limits, and what is felt there {shown}", [*where, *felt], at),
    ]
    if found.given_effort is not UNSET and found.missed is not UNSET:
        force = ", ".join(f"{x:g}" for x in np.asarray(found.given_force_n))
        needed = [(name, found.effort_unit[name].removesuffix("/N"), effort) for name, effort in found.given_effort.items()]
        blocks.append(
            _table(f"Efforts that hold weight, springs and ({force}) N on site {found.site} {shown}", [*where, *needed], at)
        )
        name = max(found.missed, key=lambda one: float(found.missed[one].max()))
        if lacking := int((found.missed[name] > 0).sum()):
            most, unit = float(found.missed[name].max()), "N.m" if found.units[name] == "deg" else "N"
            text = (
                f"the limits cannot hold this force at {lacking} of {n} poses; they lack up to {most:.4g} {unit} on {name}"
            )
            blocks.append(Text(text=text, tone="note"))
    return blocks


def _table(title: str, columns: Sequence[tuple[str, str, np.ndarray]], at: np.ndarray) -> Table:
    return table_of(title, [(head, unit) for head, unit, _ in columns], [[float(x[k]) for _, _, x in columns] for k in at])


def _without_rounding(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return arrays with values that are rounding errors of the largest of them as zero."""
    size = max((float(np.abs(x[np.isfinite(x)]).max(initial=0.0)) for x in values.values()), default=0.0)
    return {name: np.where(np.abs(x) <= ROUNDING_SHARE * size, 0.0, x) for name, x in values.items()}


def statics_plots(found: SiteStatics) -> list[Plot]:
    """Return the plots of a site's rates and largest pushes over the coordinate that moves most."""
    from linkplan.studies.check.path_plots import inner_ends  # which loads matplotlib

    axes, name = found.axes, max(found.position, key=lambda one: float(np.ptp(found.position[one])))
    if not axes or len(found.place_m) < 2:
        return []
    x = found.position[name]
    order = np.argsort(x, kind="stable")
    axis = Axis(label=name, unit=found.units[name])
    rates = [
        Line(name=f"{_AXES[k]} per {one}", values=values[order, k], unit=found.rate_unit[one])
        for one, values in found.rate.items()
        for k in axes
    ]
    pushes = [
        Line(name=f"{word} {_AXES[k]}", values=found.force_n[order, k, end], unit="N")
        for k in axes
        for end, word in enumerate(("least", "most"))
    ]
    of_lines = (
        (f"Site {found.site} per motion of the drive", "rate", rates),
        (f"Pushes of site {found.site}", "force", pushes),
    )
    return [
        plot for title, what, lines in of_lines for plot in plots(title, what, axis, x[order], lines, ends=inner_ends(lines))
    ]
