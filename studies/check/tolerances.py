"""How errors of a machine's numbers move its sites, joints, ratios and holding efforts over the reach.

The independent coordinates s stay where they are, and the loops close with other numbers p: phi(q, p) = 0 gives

    dz/dp = -J_z^-1 dphi/dp,     dy/dp = d_p y + d_z y dz/dp

of each quantity y(q, p). With the tolerances t of the numbers, the worst case of y is sum |dy/dp| t, and its standard
deviation is the root of sum (dy/dp sd)^2. A number without an sd has t / sqrt(3), as for errors spread evenly between -t
and t. The play of a pin is a tolerance of its two coordinates. Near a singular pose no slope says how far the loops move:
poses at which the tolerances may change a determinant of the closure by more than half of its value are left out.
"""

import fnmatch
from collections.abc import Iterator, Mapping, Sequence

import casadi as ca
import numpy as np
from msgspec import Struct

from linkplan.models.closure.rank import ROUNDING_SHARE
from linkplan.models.errors import ProblemError, nearest
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import parameters_of
from linkplan.models.poses.along import sampled
from linkplan.models.tree.dynamics import site_names
from linkplan.planner.problem.keys.sections import ParameterTable
from linkplan.studies.check.kinematic_loop_report import KinematicLoopPath
from linkplan.studies.output.document import Axis, Block, Plot, Text, table_of
from linkplan.studies.output.lines import Line, plots

# How many causes of an error a table names.
_NAMED_CAUSES = 3


class Tolerances(Struct, frozen=True, kw_only=True, eq=False):
    """The errors of quantities along a path of n poses, for the tolerances of n_p numbers of the model.

    The slopes are those of a quantity by each number, in the quantity's unit per SI unit of the number. They are NaN at
    `n_near_singular` poses, where errors are not small.
    """

    path: str
    position: dict[str, np.ndarray]  # (n,) of the independent coordinates [deg or m]
    units: dict[str, str]  # of the positions
    tolerance: dict[str, float]  # of each number [SI]
    sd: dict[str, float]  # of each number [SI]
    unit: dict[str, str]  # of each quantity
    slope: dict[str, np.ndarray]  # of each quantity (n, n_p)
    n_near_singular: int

    def worst(self, quantity: str) -> np.ndarray:
        """Return the largest error (n,) of a quantity within the tolerances, to first order."""
        return np.abs(self.slope[quantity]) @ np.array([*self.tolerance.values()])

    def rms(self, quantity: str) -> np.ndarray:
        """Return the standard deviation (n,) of a quantity, to first order."""
        return np.sqrt(self.slope[quantity] ** 2 @ np.square([*self.sd.values()]))

    def causes(self, quantity: str, pose: int) -> list[tuple[str, float]]:
        """Return the numbers that cause most of a quantity's worst case at a pose, with their shares, largest first."""
        parts = np.abs(self.slope[quantity][pose]) * [*self.tolerance.values()]
        order = np.argsort(-parts, kind="stable")[:_NAMED_CAUSES]
        names = [*self.tolerance]
        return [(names[k], float(parts[k] / parts.sum())) for k in order if parts[k] > 0]


def with_tolerances(
    mechanism: Mechanism, asked: Mapping[str, float], own: Mapping[str, tuple[float, float]]
) -> tuple[Mechanism, dict[str, tuple[float, float]]]:
    """Return a mechanism whose numbers with a tolerance are symbols, and the tolerance and sd of each [SI].

    Args:
        mechanism: the nominal machine.
        asked: tolerances [SI] by name or by a pattern of names, such as "*.length".
        own: tolerances and standard deviations by name, those of a problem's [parameters].

    Raises:
        ProblemError: for a name or pattern that no number has, a tolerance that is not positive, or no tolerance at all.
    """
    known, found = parameters_of(mechanism.model), dict(own)
    for pattern, tolerance in asked.items():
        names = [name for name in known if fnmatch.fnmatchcase(name, pattern)]
        if not names:
            raise ProblemError(
                f"tolerance of '{pattern}': no number of '{mechanism.name}' has this name{nearest(pattern, list(known))};"
                " `check` with `parameters` lists them"
            )
        if not (np.isfinite(tolerance) and tolerance > 0):
            raise ProblemError(f"tolerance of '{pattern}' must be a positive number, got {tolerance!r}")
        errors = ParameterTable(tolerance=float(tolerance)).errors
        assert errors is not None  # the tolerance is positive
        found |= dict.fromkeys(names, errors)
    if not found:
        raise ProblemError("there is no tolerance: name them, NAME=VALUE, or give a tolerance or sd in [parameters]")
    further = [name for name in found if name not in [one.name for one in mechanism.parameters]]
    return (mechanism.with_parameters(dict.fromkeys(further)) if further else mechanism), found


def tolerances_along(path: KinematicLoopPath, mechanism: Mechanism, errors: Mapping[str, tuple[float, float]]) -> Tolerances:
    """Return the errors along a path of a mechanism whose parameters include the numbers with `errors`."""
    names = [one.name for one in mechanism.parameters]
    columns = [names.index(name) for name in errors]
    unit, quantities, slopes = _slopes(mechanism)
    n = len(path.poses)
    values = np.tile(mechanism.parameter_values, (n, 1))
    found = sampled(slopes, path.poses, values)[:, :, columns]
    y = sampled(quantities, path.poses, values)[:, :, 0]
    errs = np.abs(found[:, len(unit) :]) @ np.array([tolerance for tolerance, _ in errors.values()])
    near = np.any(errs > 0.5 * np.abs(y[:, len(unit) :]), axis=1)
    sizes = np.maximum(np.abs(y[~near]).max(axis=0, initial=0.0), np.abs(found[~near]).max(axis=(0, 2), initial=0.0))
    kinds = np.array([*unit.values(), *(["determinant"] * (len(sizes) - len(unit)))])
    noise = ROUNDING_SHARE * np.array([sizes[kinds == kind].max() for kind in kinds])  # rounding of the largest of its unit
    found = np.where(np.abs(found) > noise[None, :, None], found, 0.0)
    found[near] = np.nan
    of = mechanism.independent_joints
    return Tolerances(
        path=path.title,
        position={joint.name: joint.shown(x) for joint, x in zip(of, path.positions.T, strict=True)},
        units={joint.name: joint.unit for joint in of},
        tolerance={name: tolerance for name, (tolerance, _) in errors.items()},
        sd={name: sd for name, (_, sd) in errors.items()},
        unit=unit,
        slope={name: found[:, row] for row, name in enumerate(unit)},
        n_near_singular=int(near.sum()),
    )


def _slopes(mechanism: Mechanism) -> tuple[dict[str, str], ca.Function, ca.Function]:
    """Return the quantities' units by name, the function q, p -> quantities, and q, p -> their slopes (n_y, n_p).

    After the named quantities, the functions return the determinants of the closure's blocks.
    """
    dynamics = mechanism.parametric_dynamics()
    q, p = ca.SX.sym("q", mechanism.n_q), ca.SX.sym("p", len(mechanism.parameters))
    unit: dict[str, str] = {}
    rows: list[ca.SX] = []
    for index in dynamics.dependent:
        joint = mechanism.joints[index]
        unit[f"joint {joint.name}"] = joint.unit
        rows.append(q[index] * joint.shown(1.0))
    places = dynamics.site_places(q, p)
    for name in site_names(mechanism.model):
        for axis, one in zip("xyz", ca.vertsplit(places[:, int(mechanism.model.site(name).id)]), strict=True):
            unit[f"site {name} {axis}"] = "mm"
            rows.append(1e3 * one)
    ratio, still = dynamics.effort_map(q, p), ca.SX.zeros(mechanism.dof)
    weight = dynamics.inverse_dynamics(q, still, still, p)
    square = mechanism.n_u == mechanism.dof
    for k, joint in enumerate(mechanism.independent_joints):
        for j, actuator in enumerate(mechanism.actuators):
            unit[f"ratio {actuator.name} on {joint.name}"] = ""
            rows.append(ratio[k, j])
    hold = ca.solve(ratio, weight) if square else weight
    held = [(one.name, one.unit) for one in mechanism.actuators]
    held = held if square else [(joint.name, joint.si_units[1]) for joint in mechanism.independent_joints]
    for (name, of), one in zip(held, ca.vertsplit(hold), strict=True):
        unit[f"holding effort {name}"] = of
        rows.append(one)
    y = ca.vertcat(ca.SX(0, 1), *rows, *([dynamics.block_singularity(q, p)] if dynamics.dependent else []))
    by_p = ca.jacobian(y, p)
    bound = list(dynamics.dependent)
    if bound:
        phi = dynamics.independent_closure(q, p)
        moved = ca.solve(ca.jacobian(phi, q)[:, bound], -ca.jacobian(phi, p))
        by_p += ca.jacobian(y, q)[:, bound] @ moved
    return unit, ca.Function("y", [q, p], [ca.densify(y)]), ca.Function("slopes", [q, p], [ca.densify(by_p)])


def tolerance_blocks(found: Tolerances) -> list[Block]:
    """Return the table of every quantity's largest error along a path, with the pose and the causes."""
    moved = [name for name, x in found.position.items() if len(x) == 1 or np.ptp(x) > 0] or list(found.position)
    rows: list[list[object]] = []
    for name, unit in found.unit.items():
        worst, rms = found.worst(name), found.rms(name)
        if not np.any(worst > 0):
            continue
        at = int(np.nanargmax(worst))
        causes = ", ".join(f"{one} {100 * share:.0f} %" for one, share in found.causes(name, at))
        where = [float(found.position[one][at]) for one in moved]
        rows.append([name, unit, float(worst[at]), float(rms[at]), float(np.sqrt(np.nanmean(rms**2))), *where, causes])
    title = f"Errors by tolerances along {found.path}: worst case, and standard deviation there and over the path"
    n = len(next(iter(found.position.values())))
    if found.n_near_singular == n:
        return [
            Text(text=f"{title}: not given, since errors within these tolerances are not small at any pose", tone="note")
        ]
    if not rows:
        return [Text(text=f"{title}: none of the tolerances moves anything", tone="note")]
    heads = [("quantity", ""), ("unit", ""), ("worst case", ""), ("sd there", ""), ("rms sd", "")]
    heads += [(f"worst at {one}", found.units[one]) for one in moved]
    blocks: list[Block] = [table_of(title, [*heads, ("causes of the worst case", "")], rows)]
    if found.n_near_singular:
        text = f"{found.n_near_singular} of {n} poses are left out: there, near a"
        blocks.append(Text(text=f"{text} singular pose, errors within the tolerances are not small", tone="note"))
    return blocks


def tolerance_plots(found: Tolerances) -> Iterator[Plot]:
    """Yield the plots of the worst cases over the coordinate that moves most, one for each unit."""
    from linkplan.studies.check.path_plots import inner_ends  # which loads matplotlib

    name = max(found.position, key=lambda one: float(np.ptp(found.position[one])))
    x = found.position[name]
    if len(x) < 2:
        return
    order = np.argsort(x, kind="stable")
    axis = Axis(label=name, unit=found.units[name])
    for what in ("joint", "site", "ratio", "holding effort"):
        of: Sequence[str] = [one for one in found.unit if one.startswith(f"{what} ") and np.any(found.worst(one) > 0)]
        lines = [
            Line(name=one.removeprefix(f"{what} "), values=found.worst(one)[order], unit=found.unit[one] or "1")
            for one in of
        ]
        title = f"Worst case of each {what}"
        yield from plots(title, "error", axis, x[order], lines, ends=inner_ends(lines)) if lines else ()
