"""A motion of the model near a plan: Newton-Kantorovich's theorem for the planned efforts.

The plan is y = (s, s'), and f(s, s', u(t)) the model's acceleration. The model's own motion under the planned efforts, from
the plan's start, is y + e with

    e' - A e = g(t, e) = (0, -d) + F(y + e) - F(y) - A e,   d = s'' - f(s, s', u),   A(t) near dF/dy,

where A is a polynomial in numbers on each box. Phi(t, tau) is the fundamental matrix of e' = A e, and L^-1 g is the integral
of Phi(t, tau) g(tau) over tau < t. With W(t) >= |L^-1 d| by components, and D >= |dF/dy - A| over the box and over a tube
around y, the map e -> L^-1 g(e) contracts in the norm max |e| / W by

    Z = max over t of (|L^-1| D W) / W.

If Z <= 1/2 and W / (1 - Z) lies in the tube, the tube contains exactly one motion, and |e| <= W / (1 - Z) (Kantorovich and
Akilov, Functional Analysis, 1982, chapter XVIII; Nakao, Plum and Watanabe, Numerical Verification Methods, 2019, section
6.1). With D as the Lipschitz constant of dF/dy times the tube's width, this is the condition h <= 1/2.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from flint import arb, arb_mat, arb_poly, arb_series, ctx

from linkplan.models.mechanism import Mechanism
from linkplan.planner.certificate.certificate import INTEGRATION_M, VELOCITY_SHARE
from linkplan.planner.keys.kinds import INTEGRATION_DEG
from linkplan.planner.proof.branch import krawczyk, pose_of, series_of
from linkplan.planner.proof.finding import Finding
from linkplan.planner.proof.linear import NotSeparatedError, solve
from linkplan.planner.proof.motion import Piece, State
from linkplan.planner.proof.taylor import TaylorForm, above
from linkplan.planner.proof.walk import Ball, Walk, constant_term, dense, walk_of
from linkplan.planner.trajectory import Trajectory

# The largest contraction Z: Newton-Kantorovich's condition.
MAX_CONTRACTION = 0.5
# What is tried in turn: half the tube's width as a share of each coordinate's span and speed; and the remainder of the
# defect, as a share of the largest acceleration, down to which boxes are halved. A narrow tube needs short boxes.
ATTEMPTS = ((5e-5, 1e-6), (5e-6, 1e-8))
# Boxes are halved until dF/dy is known to this share of its size, or so often.
_VARIATION_SHARE, _MAX_HALVINGS = 1.0, 6
# A motion is looked for as long as so many times the time of the other claims, or so long [s], on so many boxes.
EXISTENCE_SHARE, EXISTENCE_SECONDS, _MAX_BOXES = 2.0, 3.0, 1000
# Coefficients of dF/dy on a box.
_SLOPE_ORDER = 4
# Terms of the series of Phi over one box, which decrease by a fourth each.
_SERIES_TERMS = 40


_NAME = "the model's own motion under the planned efforts"


class NoMotionError(ArithmeticError):
    """No motion is proved near the plan; the message says why."""


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Nearby:
    """Radii (n_s,) of positions and velocities within which one motion of the model exists, and the contraction Z."""

    position: np.ndarray
    velocity: np.ndarray
    contraction: float


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class _Box:
    """A box: its width [s], A (n_s, 2 n_s) by coefficients of x in [-1, 1], D, the forms of d, and the plan's first jump."""

    width: arb
    slopes: list[list[list[float]]]
    variation: list[list[arb]]
    defect: Sequence[TaylorForm]
    jump: list[arb]


def no_motion(why: str) -> Finding:
    """Return the finding that no motion is proved near a plan."""
    return Finding(name=_NAME, answer="sampled", reason=f"by an integration with error control: {why}")


class Neighbourhood:
    """The bounds on a motion's boxes, collected in the order of time.

    `failure` says why there are none; `hopeless` that another attempt would not find a motion either.
    """

    def __init__(self, mechanism: Mechanism, trajectory: Trajectory, tube: float, defect: float) -> None:
        self._mechanism, self._n_s, self._boxes, self._last = mechanism, mechanism.dof, [], None
        sizes = (np.ptp(trajectory.position, axis=(0, 1)), np.abs(trajectory.velocity).max(axis=(0, 1)))
        self._tube_share, self._defect_share = tube, defect
        self._tube = tube * np.concatenate([np.maximum(size, 1e-2 * size.max() + 1e-9) for size in sizes])
        self._acceleration = float(np.abs(trajectory.acceleration_at(trajectory.dense_times(2))).max(initial=1e-9))
        self._units = (trajectory.duration_s**-2, trajectory.duration_s**-1)  # of df/ds and df/dv
        self._speed = max(float(np.abs(trajectory.velocity).max()), 1e-9)
        self.failure, self.hopeless = "", False

    def takes(self, states: tuple[State, State], at: tuple[float, float], halvings: int, order: int) -> bool:
        """Add the bounds on a box, centre and radius in tau; return False if it has to be halved for them."""
        if self.failure:
            return True
        piece = states[0].piece
        if not piece.one_velocity:
            self.failure, self.hopeless = "the planned velocity is not the slope of the planned position", True
            return True
        box, last = None, halvings >= _MAX_HALVINGS
        try:
            defect = self._defect(states, order)
            if last or self._is_small(defect):
                slopes = self._slopes(states, at)
                if last or self._is_tight(slopes):
                    box = self._box(states, at, defect, slopes)
        except (NotSeparatedError, ZeroDivisionError, ValueError):  # flint's divisor may vanish
            if last:
                self.failure = (
                    f"the model's slopes are not enclosed at t = {piece.begin_s + at[0] * float(piece.width):.4g} s"
                )
        if box is not None:
            self._boxes.append(box)
            if len(self._boxes) > _MAX_BOXES:
                self.failure = f"it needs more than {_MAX_BOXES} boxes"
            self._last = piece
            return True
        return bool(self.failure)

    def nearby(self) -> Nearby:
        """Return the radii within which a motion of the model under the planned efforts exists.

        Raises:
            NoMotionError: when the theorem's conditions do not hold.
        """
        if self.failure:
            raise NoMotionError(self.failure)
        found = _contracted(self._boxes, self._n_s)
        if not found.contraction <= MAX_CONTRACTION:
            raise NoMotionError(f"the contraction is {found.contraction:.2g}, which is above {MAX_CONTRACTION:g}")
        share = float((np.append(found.position, found.velocity) / self._tube).max()) * self._tube_share
        self.hopeless = share > 10 * self._tube_share
        if share > self._tube_share:
            raise NoMotionError(f"the bound on its distance is {share:.2g} of the motion's span or largest speed")
        return found

    def findings(self) -> list[Finding]:
        """Return the findings on the distance of the model's own motion from the plan, one for each position and speed."""
        try:
            near = self.nearby()
        except NoMotionError as error:
            return [no_motion(str(error))]
        found, speed = [], VELOCITY_SHARE * self._speed
        for joint, *radii in zip(self._mechanism.independent_joints, near.position, near.velocity, strict=True):
            allowed = np.radians(INTEGRATION_DEG) if joint.kind == "hinge" else INTEGRATION_M
            for what, per, radius, mark in zip(("position", "speed"), ("", "/s"), radii, (allowed, speed), strict=True):
                bound, most = joint.shown(float(radius)), joint.shown(float(mark))
                answer = "proved" if bound <= most else "sampled"
                reason = "" if bound <= most else f"a motion is proved within {bound:.3g} {joint.unit}{per} only"
                shared = {"unit": joint.unit + per, "bound": bound, "mark": most, "margin": most - bound}
                named = f"{_NAME}: distance from the planned {what} of {joint.name}"
                found.append(Finding(name=named, answer=answer, boxes=len(self._boxes), reason=reason, **shared))
        return found

    def _defect(self, states: tuple[State, State], order: int) -> list[TaylorForm]:
        """Return the forms of the defect d = M_r^-1 r (n_s,) of the planned motion on a box."""
        inertia, found = _model_of(self._mechanism)[0], []
        for state, cap in zip(states, (order + 2, order + 3), strict=True):
            ctx.cap = cap
            found += solve(inertia(state.q)[0], [state.of_position.residual])
        return [TaylorForm.of(a, b, order) for a, b in zip(*found, strict=True)]

    def _box(self, states: tuple[State, State], at: tuple[float, float], defect, forms) -> _Box:
        """Return a box; A is the middles of the coefficients of the forms of dF/dy."""
        slopes = [[[float(c.mid()) for c in form.coefficients] for form in row] for row in forms]
        variation = [
            [_size(form.coefficients, middles) + form.remainder for form, middles in zip(*rows, strict=True)]
            for rows in zip(forms, slopes, strict=True)
        ]
        if not all(x.is_finite() for x in (*(form.remainder for form in defect), *(y for row in variation for y in row))):
            raise NotSeparatedError("a slope is not bounded")
        piece = states[0].piece
        jump = [arb(0)] * (2 * self._n_s)
        if self._last not in (None, piece):
            jump = [abs(x - y) for x, y in zip(_state(piece, 0), _state(self._last, 1), strict=True)]
        width = piece.width * arb(2 * at[1])
        return _Box(width=width, slopes=slopes, variation=variation, defect=defect, jump=jump)

    def _slopes(self, states: tuple[State, State], at: tuple[float, float]) -> list[list[TaylorForm]]:
        """Return the forms of df/d(s, v) (n_s, 2 n_s) on a box, for all states within the tube."""
        blocks, piece, n_s, found = states[0].blocks, states[0].piece, self._n_s, []
        along, rate = arb_poly([arb(at[0]), arb(at[1])]), 1 / (piece.width * arb(at[1]))
        curves = [[p(along) for p in piece.effort], [p(along) for p in piece.position]]  # u, s, v, a of x in [-1, 1]
        for _ in range(2):
            curves.append([rate * p.derivative() for p in curves[-1]])
        balls = [arb(0, float(x)) for x in self._tube]
        guess = np.array([float(constant_term(z).mid()) for z in states[0].z])
        for x, cap in ((arb(0), _SLOPE_ORDER), (arb(0, 1), _SLOPE_ORDER + 1)):
            ctx.cap, about = cap, arb_poly([x, 1])
            u, s, v, a = ([arb_series(p(about).coeffs(), prec=cap) for p in curve] for curve in curves)
            s, v = ([p + e for p, e in zip(*pair, strict=True)] for pair in ((s, balls[:n_s]), (v, balls[n_s:])))
            root = krawczyk(blocks, [constant_term(one) for one in s], guess)
            q = pose_of(blocks, s, series_of(blocks, s, root.enclosure, cap))
            found.append(_slopes_at(self._mechanism, q, v, a, u))
        if not all(region.contains(z[0]) for region, z in zip(root.region, states[1].z, strict=True)):
            raise NotSeparatedError("the branch is not known to be the plan's")
        return [
            [TaylorForm.of(at, over, _SLOPE_ORDER) for at, over in zip(*rows, strict=True)]
            for rows in zip(*found, strict=True)
        ]

    def _is_small(self, defect: Sequence[TaylorForm]) -> bool:
        """Return True if a shorter box would not bound the defect much better."""
        least = self._defect_share * self._acceleration
        return all(form.remainder <= max(least, above(_size(form.coefficients)) / 4) for form in defect)

    def _is_tight(self, slopes: Sequence[Sequence[TaylorForm]]) -> bool:
        """Return True if a shorter box would not bound dF/dy much better; what the tube adds stays."""
        n_s = self._n_s
        for k, unit in zip((0, n_s), self._units, strict=True):
            entries = [form for row in slopes for form in row[k : k + n_s]]
            size = max(unit, *(abs(float(form.coefficients[0].mid())) for form in entries))
            if not all(form.remainder <= _VARIATION_SHARE * size for form in entries):
                return False
        return True


def _state(piece: Piece, tau: float) -> list[arb]:
    """Return the planned positions and their slopes (2 n_s,) at an end of an interval."""
    return [p(arb(tau)) for p in piece.position] + [p.derivative()(arb(tau)) / piece.width for p in piece.position]


@functools.lru_cache(maxsize=16)
def _model_of(mechanism: Mechanism) -> tuple[Walk, Walk, Walk]:
    """Return q -> M_r, (q, v, a, u) -> residual r, and -> dr/ds along the closure and dr/dv side by side."""
    dynamics, n_s = mechanism.dynamics, mechanism.dof
    names = (("q", mechanism.n_q), ("v", n_s), ("a", n_s), ("u", len(mechanism.actuators)))
    q, v, a, u = symbols = [ca.SX.sym(name, n) for name, n in names]
    r = dynamics.residual(q, v, a, u)
    by = ca.horzcat(ca.jacobian(r, q) @ dynamics.velocity_map(q), ca.jacobian(r, v))
    residual, slopes = (walk_of(ca.Function(name, symbols, [of], {"cse": True})) for name, of in (("r", r), ("by", by)))
    return walk_of(dynamics.reduced_inertia), residual, slopes


def _slopes_at(mechanism: Mechanism, q, v, a, u) -> list[list[Ball]]:
    """Return df/d(s, v) (n_s, 2 n_s) at poses q and rates v, from any accelerations a (n_s,)."""
    inertia_of, residual, slopes = _model_of(mechanism)
    inertia, n_s = inertia_of(q)[0], len(v)
    (defect,) = solve(inertia, [dense(residual(q, v, a, u)[0], n_s)])
    by = slopes(q, v, [x - y for x, y in zip(a, defect, strict=True)], u)[0]
    columns = solve(inertia, [[-x for x in dense(by, n_s, column)] for column in range(2 * n_s)])
    return [[column[i] for column in columns] for i in range(n_s)]


def _size(coefficients: Sequence[arb], middles: Sequence[float] | None = None) -> arb:
    """Return a bound on a polynomial of x in [-1, 1], or on its distance from one with coefficients in numbers."""
    middles = [0.0] * len(coefficients) if middles is None else middles
    return sum((abs(c - arb(m)).upper() for c, m in zip(coefficients, middles, strict=True)), arb(0))


def _contracted(boxes: Sequence[_Box], n_s: int) -> Nearby:
    """Return the radii from L^-1 d and |L^-1| D W, box by box; every later box sees the earlier ones' through Phi.

    The polynomial of d acts with its sign: over an interval of collocation it is zero on average. Its remainders, the plan's
    jumps and D W act by their size.
    """
    n, unit = 2 * n_s, _rate_unit(boxes, n_s)
    scale = [arb(1)] * n_s + [1 / unit] * n_s  # of (s, s' / unit)
    eye, signed = arb_mat(n, n, [int(i == j) for i in range(n) for j in range(n)]), arb_mat(n, 1)
    phi: arb_mat | None = None  # Phi(t, t_j) side by side for the ends t_j of earlier boxes
    sources: list[list[arb]] = []  # at each of these ends, row by row: by remainders, and by D W
    radii, contraction = [arb(2) ** -300] * n, arb(0)

    def forced(grown: arb_mat, width: arb, rates: Sequence[arb]) -> arb_mat:
        return grown * arb_mat(n, 1, [arb(0)] * n_s + [width * x / unit for x in rates])

    for box in boxes:
        for i, jump in enumerate(box.jump if sources else []):
            sources[i - n][0] += jump * scale[i]
        before = arb_mat(n, 2) if phi is None else _absolute(phi) * arb_mat(sources)
        grown, (step, added) = _growth(box, unit, n_s), _transition(box, unit, n_s)
        own = forced(grown, box.width, [form.remainder for form in box.defect])
        begin = _absolute(signed) + arb_mat(n, 1, [before[i, 0] for i in range(n)])
        here = grown * begin + own + forced(grown, box.width, [_size(form.coefficients) for form in box.defect])
        radii = [x.max(here[i, 0].upper()) for i, x in enumerate(radii)]
        unscaled = [x / y for x, y in zip(radii, scale, strict=True)]
        more = forced(
            grown, box.width, [sum((d * w for d, w in zip(row, unscaled, strict=True)), arb(0)) for row in box.variation]
        )
        all_more = grown * arb_mat(n, 1, [before[i, 1] for i in range(n)]) + more
        for i in range(n):
            contraction = contraction.max((all_more[i, 0] / radii[i]).upper())
        phi, signed = eye if phi is None else _beside(step * phi, eye), step * signed + added
        sources += [[own[i, 0], more[i, 0]] for i in range(n)]
    Z = above(contraction)
    share = [above(x / y / (1 - contraction)) if Z < 1 else np.inf for x, y in zip(radii, scale, strict=True)]
    return Nearby(position=np.array(share[:n_s]), velocity=np.array(share[n_s:]), contraction=Z)


def _rate_unit(boxes: Sequence[_Box], n_s: int) -> arb:
    """Return a rate [1/s] that makes positions and velocities alike: the root of the largest da/ds."""
    largest = max((abs(entry[0]) for box in boxes for row in box.slopes for entry in row[:n_s]), default=0.0)
    return arb(max(largest, 1.0)).sqrt().mid()


def _absolute(matrix: arb_mat) -> arb_mat:
    return arb_mat(matrix.nrows(), matrix.ncols(), [abs(x).upper() for x in matrix.entries()])


def _beside(left: arb_mat, right: arb_mat) -> arb_mat:
    """Return [left right]."""
    rows = zip(left.tolist(), right.tolist(), strict=True)
    return arb_mat([[*a, *b] for a, b in rows])


def _scaled_slopes(box: _Box, unit: arb, n_s: int, degree: int) -> arb_mat:
    """Return the coefficient of x^degree of A, for states (s, s' / unit)."""
    rows = [[arb(int(j == i + n_s and not degree)) * unit for j in range(2 * n_s)] for i in range(n_s)]
    for row in box.slopes:
        values = [arb(entry[degree]) if degree < len(entry) else arb(0) for entry in row]
        rows.append([x / unit for x in values[:n_s]] + values[n_s:])
    return arb_mat(rows)


def _growth(box: _Box, unit: arb, n_s: int) -> arb_mat:
    """Return a bound on |Phi(t, tau)| for all times of a box: exp(h |A|)."""
    terms = max(len(entry) for row in box.slopes for entry in row)
    total = arb_mat(2 * n_s, 2 * n_s)
    for degree in range(terms):
        total += _absolute(_scaled_slopes(box, unit, n_s, degree))
    return _absolute((box.width * total).exp())


def _transition(box: _Box, unit: arb, n_s: int) -> tuple[arb_mat, arb_mat]:
    """Return Phi over a box, and what the polynomial of -d adds over it.

    Both are columns of Y with Y' = A Y, A extended by a column of -d. The series of Y in x + 1 has terms with
    m Y_m = h / 2 sum_i A_i Y_(m - 1 - i). With |Y(z)| <= Y_R = exp(int_0^R |A|) on the disc of radius R = 8, those after p
    are below Y_R 4^-p / 3 at 2.
    """
    n, half = 2 * n_s, box.width / 2
    terms = max(*(len(entry) for row in box.slopes for entry in row), *(len(form.coefficients) for form in box.defect))
    about_middle = []
    for degree in range(terms):
        forces = [-form.coefficients[degree] / unit if degree < len(form.coefficients) else arb(0) for form in box.defect]
        column = arb_mat([[x] for x in [arb(0)] * n_s + forces])
        rows = _beside(_scaled_slopes(box, unit, n_s, degree), column).tolist()
        about_middle.append(arb_mat([*rows, [arb(0)] * (n + 1)]))
    A = []
    for i in range(terms):  # of powers of x + 1
        shifted = arb_mat(n + 1, n + 1)
        for j in range(i, terms):
            shifted += about_middle[j] * (math.comb(j, i) * (-1) ** (j - i))
        A.append(shifted * half)
    series = [arb_mat(n + 1, n + 1, [int(i == j) for i in range(n + 1) for j in range(n + 1)])]
    for m in range(1, _SERIES_TERMS + 1):
        term = arb_mat(n + 1, n + 1)
        for i in range(min(m, terms)):
            term += A[i] * series[m - 1 - i]
        series.append(term * (arb(1) / m))
    total, power = arb_mat(n + 1, n + 1), arb(1)
    for term in series:
        total, power = total + term * power, 2 * power
    grown = arb(0)
    for i, a in enumerate(A):
        norm = arb(0)
        for row in _absolute(a).tolist():
            norm = norm.max(sum(row, arb(0)))
        grown += norm * arb(8) ** (i + 1) / (i + 1)
    tail = arb(0, (grown.exp() / 3 / arb(4) ** _SERIES_TERMS).upper())
    rows = [[x + tail for x in row] for row in total.tolist()[:n]]
    return arb_mat([row[:n] for row in rows]), arb_mat([row[n:] for row in rows])
