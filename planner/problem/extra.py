"""Users' own path limits and running costs: CasADi expressions of named joints, efforts and sites."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from linkplan.models.errors import ProblemError, choose, one_line, shown
from linkplan.models.mechanism import Mechanism
from linkplan.models.poses.along import sampled
from linkplan.models.poses.body_angles import body_index, turning
from linkplan.models.tree.dynamics import site_index
from linkplan.planner.problem.instant import Instant, free_instant, jerk_columns, motion_symbols

# The longest name, because names appear in sentences.
MAX_NAME_CHARACTERS = 100


@dataclass(frozen=True, eq=False, slots=True)
class _Named:
    """Entries of a column by name."""

    what: str
    names: tuple[str, ...]
    column: ca.SX

    def __getitem__(self, name: str) -> ca.SX:
        return self.column[self.names.index(choose(self.what, name, self.names, ProblemError))]


@dataclass(frozen=True, eq=False, slots=True)
class NamedInstant:
    """One instant of a motion for users' expressions, in SI: `at.position_rad["O"]`, `at.site("foot")[2]`.

    Every joint, dependent or not, has a position [rad or m], a velocity, an acceleration and a jerk; every actuator has an
    effort [N.m or N].
    """

    instant: Instant

    @property
    def position_rad(self) -> _Named:
        """The joints' positions [rad or m] by name."""
        return _Named("joint in at.position_rad", _joints(self.instant.mechanism), self.instant.q)

    @property
    def velocity_rad_s(self) -> _Named:
        """The joints' velocities [rad/s or m/s] by name."""
        return _Named("joint in at.velocity_rad_s", _joints(self.instant.mechanism), self.instant.joint_rates)

    @property
    def acceleration_rad_s2(self) -> _Named:
        """The joints' accelerations [rad/s2 or m/s2] by name."""
        accelerations = self.instant.joint_accelerations
        return _Named("joint in at.acceleration_rad_s2", _joints(self.instant.mechanism), accelerations)

    @property
    def jerk_rad_s3(self) -> _Named:
        """The joints' jerks [rad/s3 or m/s3] by name."""
        return _Named("joint in at.jerk_rad_s3", _joints(self.instant.mechanism), self.instant.joint_jerks)

    @property
    def effort(self) -> _Named:
        """The actuators' efforts [N.m or N] by name."""
        names = tuple(actuator.name for actuator in self.instant.mechanism.actuators)
        return _Named("actuator in at.effort", names, self.instant.u)

    def site(self, name: str) -> ca.SX:
        """Return the position (3,) [m] of a site in the world."""
        return self._of_site("site", name, self.instant.of_pose("site_places"))

    def site_velocity(self, name: str) -> ca.SX:
        """Return the velocity (3,) [m/s] of a site in the world."""
        return self._of_site("site_velocity", name, self.instant.site_velocities)

    def site_acceleration(self, name: str) -> ca.SX:
        """Return the acceleration (3,) [m/s2] of a site in the world."""
        return self._of_site("site_acceleration", name, self.instant.site_accelerations)

    def site_jerk(self, name: str) -> ca.SX:
        """Return the jerk (3,) [m/s3] of a site in the world."""
        return self._of_site("site_jerk", name, self.instant.site_jerks)

    def body_angle_rad(self, name: str) -> ca.SX:
        """Return the angle [rad] of a body, the sum of the angles of the hinges that turn it."""
        mechanism, what = self.instant.mechanism, "at.body_angle_rad"
        sigma = turning(mechanism, body_index(mechanism.model, name, what, ProblemError), what, ProblemError)
        return ca.dot(ca.DM(sigma), self.instant.q)

    def _of_site(self, what: str, name: str, columns: ca.SX) -> ca.SX:
        return columns[:, site_index(self.instant.mechanism.model, name, f"at.{what}", ProblemError)]


Expression = Callable[[NamedInstant], ca.SX]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ExtraLimit:
    """A limit on every instant, lower <= expression <= upper.

    Args:
        name: in messages.
        expression: from a `NamedInstant` to a CasADi scalar, twice differentiable along the motion. lower, upper: bounds,
            one of them finite.
        unit: of the expression, for messages.

    Example::

        bent = linkplan.ExtraLimit(name="angle of C", expression=lambda at: at.position_rad["C"], lower=-3.0, unit="rad")
        linkplan.Problem.from_file("knee-reach").replace(extra_limits=[bent])
    """

    kind: ClassVar[Literal["limit"]] = "limit"
    name: str
    expression: Expression
    lower: float = -np.inf
    upper: float = np.inf
    unit: str = ""

    def __post_init__(self) -> None:
        _check_words(self)
        for field in ("lower", "upper"):
            object.__setattr__(self, field, _number(getattr(self, field), f"extra limit '{self.name}': {field}"))
        if not (self.lower < self.upper and np.isfinite([self.lower, self.upper]).any()):
            bounds = f"lower = {self.lower:g} and upper = {self.upper:g}"
            raise ProblemError(f"extra limit '{self.name}' needs lower < upper, one of them finite, got {bounds}")

    @property
    def size(self) -> float:
        """The scale of its row in a program: the larger absolute value of its finite bounds."""
        ends = np.abs([self.lower, self.upper])
        return float(ends[np.isfinite(ends)].max()) or 1.0


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ExtraCost:
    """A running cost: the objective plus `weight` times the integral of an expression over the motion.

    Args:
        name: in messages, with the names of the objective's terms.
        expression: from a `NamedInstant` to a CasADi scalar, twice differentiable along the motion.
        weight: positive, per SI unit of the integral.
        unit: of the integral, for messages.

    Example::

        def swing(at):
            return at.velocity_rad_s["A"] ** 2

        calm = linkplan.ExtraCost(name="swing of A", expression=swing, weight=1e-3, unit="rad2/s")
        linkplan.Problem.from_file("knee-reach").replace(extra_costs=[calm])
    """

    kind: ClassVar[Literal["cost"]] = "cost"
    name: str
    expression: Expression
    weight: float = 1.0
    unit: str = ""

    def __post_init__(self) -> None:
        _check_words(self)
        object.__setattr__(self, "weight", _number(self.weight, f"extra cost '{self.name}': weight"))
        if not (np.isfinite(self.weight) and self.weight > 0):
            raise ProblemError(f"extra cost '{self.name}': weight must be a positive number, got {self.weight:g}")


Extra = ExtraLimit | ExtraCost


def expressed(extra: Extra, at: Instant) -> ca.SX:
    """Return the expression of an extra limit or cost at an instant.

    Raises:
        ProblemError: for a name that the mechanism does not have, or an expression that is not a scalar of the motion.
    """
    what = f"extra {extra.kind} '{extra.name}'"
    try:
        found = extra.expression(NamedInstant(at))
    except ProblemError as error:
        raise ProblemError(f"{what}: {error}") from error
    except Exception as error:
        raise ProblemError(f"{what}: its expression fails with {type(error).__name__}: {one_line(error)}") from error
    if not isinstance(found, ca.SX) or found.shape != (1, 1):
        got = f"shape {found.shape}" if isinstance(found, ca.SX) else f"a value of type {type(found).__name__}"
        raise ProblemError(f"{what}: its expression must return a CasADi scalar, got {got}")
    return found


@functools.lru_cache(maxsize=64)
def uses(extra: Extra, mechanism: Mechanism) -> dict[str, bool]:
    """Return for each of q, v, a, u and j, the jerk, whether an expression depends on it.

    Raises:
        ProblemError: as `expressed`, for a constant expression, and for one that has NaN as a constant.
    """
    instant, symbols = free_instant(mechanism)
    found = expressed(extra, instant)
    function = ca.Function("extra", [*symbols, instant.forces], [found], {"allow_free": True})
    if function.has_free():
        raise ProblemError(f"extra {extra.kind} '{extra.name}': its expression may use only the instant's symbols")
    codes = range(function.n_instructions())
    constants = [function.instruction_constant(k) for k in codes if function.instruction_id(k) == ca.OP_CONST]
    if np.isnan(constants).any():
        raise ProblemError(f"extra {extra.kind} '{extra.name}': its expression contains NaN as a constant")
    depends = {name: ca.depends_on(found, one) for name, one in zip("qvauj", motion_symbols(instant), strict=False)}
    if not any(depends.values()):
        raise ProblemError(
            f"extra {extra.kind} '{extra.name}': its expression depends on position, velocity, acceleration, jerk or effort,"
            " got a constant"
        )
    return depends


def take_jerk(extra: Extra, mechanism: Mechanism, lacking: str | None) -> bool:
    """Return True if an extra limit or cost depends on jerk; `lacking` is a phrase on what the transcription lacks for it.

    Raises:
        ProblemError: as `uses`, and for a jerk that the transcription does not have.
    """
    given = uses(extra, mechanism)["j"]
    if given and lacking is not None:
        raise ProblemError(f"extra {extra.kind} '{extra.name}' has a jerk, which needs {lacking}")
    return given


@functools.lru_cache(maxsize=64)
def jerk_of(extra: Extra, mechanism: Mechanism) -> tuple[int, ...]:
    """Return the independent coordinates on whose jerk an extra limit or cost depends."""
    instant, _ = free_instant(mechanism)
    return jerk_columns(instant, expressed(extra, instant))


def extra_along(extra: Extra, mechanism: Mechanism, *motion: np.ndarray) -> np.ndarray:
    """Return the values (n,) of an extra limit or cost along q (n, n_q), or along q, v, a (n, n_s), u (n, n_u) and jerk.

    The jerk has the shape (n, n_s). Forces over time, as from `Mechanism.forces_at`, follow it.
    """
    instant, _ = free_instant(mechanism)
    inputs = motion_symbols(instant)[: len(motion)]
    function = ca.Function("extra", inputs, [ca.densify(expressed(extra, instant))])
    return sampled(function, *motion).reshape(-1)


def not_finite(what: str, values: np.ndarray, time: np.ndarray) -> list[str]:
    """Return a sentence on the first instant (n,) [s] at which values (n, ...) are not finite, if there is one."""
    rows = values.reshape(len(time), -1)
    bad = ~np.isfinite(rows)
    if not bad.any():
        return []
    k = int(np.argmax(bad.any(axis=1)))
    return [f"{what} is {as_no_number(rows[k][bad[k]][0])} at t = {time[k]:.4g} s"]


def as_no_number(value: float) -> str:
    """Return the text for a value that is not finite: "not finite (NaN)", "not finite (inf)"."""
    return f"not finite ({'NaN' if np.isnan(value) else f'{value:g}'})"


def extras_not_finite(extras: Sequence[Extra], mechanism: Mechanism, time: np.ndarray, *motion: np.ndarray) -> list[str]:
    """Return the sentences on extra limits and costs that are not finite along a motion, see `extra_along`."""
    along = ((f"the extra {one.kind} '{one.name}'", extra_along(one, mechanism, *motion)) for one in extras)
    return [sentence for what, values in along for sentence in not_finite(what, values, time)]


def checked_extras(extras: Sequence[Extra], kind: type, where: str) -> tuple:
    """Return extra limits or costs as a tuple.

    Raises:
        ProblemError: for other values, or two with the same name.
    """
    if isinstance(extras, str) or not isinstance(extras, Sequence) or not all(isinstance(one, kind) for one in extras):
        raise ProblemError(f"{where} must be a list of linkplan.{kind.__name__}, got {shown(repr(extras))}")
    names = [one.name for one in extras]
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"{where} must have different names, got '{name}' more than once")
    return tuple(extras)


def extras_text(extras: Sequence) -> str:
    """Return a phrase that names extra limits and costs, or their records: "the extra limit 'a' and the extra cost 'b'"."""
    *words, last = [f"the extra {one.kind} '{shown(one.name)}'" for one in extras]
    return f"{', '.join(words)} and {last}" if words else last


def _joints(mechanism: Mechanism) -> tuple[str, ...]:
    return tuple(joint.name for joint in mechanism.joints)


def _check_words(extra: Extra) -> None:
    kind, name = extra.kind, extra.name
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise ProblemError(f"an extra {kind}'s name must be printable text, got {shown(repr(name))}")
    if len(name) > MAX_NAME_CHARACTERS:
        raise ProblemError(f"an extra {kind}'s name has at most {MAX_NAME_CHARACTERS} characters, got {len(name)}")
    if not callable(extra.expression):
        raise ProblemError(
            f"extra {kind} '{name}': expression must be a function of an instant, got {shown(repr(extra.expression))}"
        )
    if not isinstance(extra.unit, str) or not extra.unit.isprintable():
        raise ProblemError(f"extra {kind} '{name}': unit must be text, got {shown(repr(extra.unit))}")


def _number(value: object, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer) or np.isnan(value):
        raise ProblemError(f"{what} must be a number, got {shown(repr(value))}")
    return float(value)
