"""Existence of a motion of the model near a plan, under the planned efforts, by the Newton-Kantorovich theorem.

The plan is y = (s, s'), and f(s, s', u(t)) is the model's acceleration. The model's own motion starts as the plan does and
has the planned efforts. It is y + e with

    e' - A e = g(t, e) = (0, -d) + F(y + e) - F(y) - A e,   d = s'' - f(s, s', u),   A(t) near dF/dy,

where A is a polynomial with floating-point coefficients on each box. Phi(t, tau) is the fundamental matrix of e' = A e, and
L^-1 g is the integral of Phi(t, tau) g(tau) over tau < t. Let W(t) >= |L^-1 d| in each component, and D >= |dF/dy - A| on
the box and in a tube around y. The map e -> L^-1 g(e) contracts in the norm max |e| / W by

    Z = max over t of (|L^-1| D W) / W.

If Z <= 1/2 and W / (1 - Z) lies in the tube, the tube contains exactly one motion, and |e| <= W / (1 - Z) (Kantorovich and
Akilov, Functional Analysis, 1982, chapter XVIII; Nakao, Plum and Watanabe, Numerical Verification Methods, 2019, section
6.1). If D is the Lipschitz constant of dF/dy times the tube's width, this is Kantorovich's condition h <= 1/2.

W grows along the motion, and hardly depends on the tube. A first tube, whose width is a guess, therefore gives the width
of the second tube: 2 W(t), the smallest that Z = 1/2 allows.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from flint import arb, arb_poly, arb_series, ctx

from linkplan.models.mechanism import Mechanism
from linkplan.planner.certificate.certificate import INTEGRATION_M
from linkplan.planner.problem.keys.kinds import INTEGRATION_DEG
from linkplan.planner.proof.branch import krawczyk, pose_of, series_of
from linkplan.planner.proof.contraction import LinearBox, contracted, size_of
from linkplan.planner.proof.curve import forces_over
from linkplan.planner.proof.finding import OWN_MOTION, Finding, no_motion
from linkplan.planner.proof.motion import Piece, State
from linkplan.planner.proof.taylor import NotSeparatedError, TaylorForm, above, solve_enclosed
from linkplan.planner.proof.walk import Ball, Walk, constant_term, dense, force_symbols, walk_of
from linkplan.planner.trajectory import VELOCITY_SHARE, Trajectory

# The largest contraction Z: Newton-Kantorovich's condition.
MAX_CONTRACTION = 0.5
# Half the first tube's width, as a share of each coordinate's span and largest speed.
_FIRST_TUBE_SHARE = 1e-6
# Boxes are halved until the remainder of the defect is this share of the largest acceleration.
_DEFECT_SHARE = 1e-7
# Boxes are halved until dF/dy varies by less than its size, or so often.
_MAX_HALVINGS = 6
# A motion is looked for at most so long [s], on so many boxes.
EXISTENCE_SECONDS, _MAX_BOXES = 60.0, 2000
# Coefficients of dF/dy on a box.
_SLOPE_ORDER = 4


class NoMotionError(ArithmeticError):
    """No motion of the model is proved near the plan; the message states the reason."""


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class ErrorTube:
    """Half widths (m, 2 n_s) of a tube around positions and velocities, each up to one of the instants (m,) [s].

    `is_guess` is True if they are a guess, not a result of bounds.
    """

    until_s: np.ndarray
    radii: np.ndarray
    is_guess: bool = False

    def at(self, end_s: float) -> np.ndarray:
        """Return the half widths (2 n_s,) that hold up to an instant."""
        return self.radii[min(np.searchsorted(self.until_s, end_s), len(self.radii) - 1)]


def first_tube(trajectory: Trajectory) -> ErrorTube:
    """Return a tube of constant width around a motion."""
    return ErrorTube(until_s=np.array([np.inf]), radii=_FIRST_TUBE_SHARE * _sizes(trajectory)[None], is_guess=True)


class Neighbourhood:
    """The bounds on the boxes of a motion, collected in the order of time.

    `failure` states why there are no bounds. `next_tube` is the tube of the next attempt; None if another attempt would
    hardly succeed.
    """

    def __init__(self, mechanism: Mechanism, trajectory: Trajectory, tube: ErrorTube) -> None:
        self._mechanism, self._n_s, self._boxes, self._last = mechanism, mechanism.dof, [], None
        self._tube, self._sizes = tube, _sizes(trajectory)
        self._acceleration = float(np.abs(trajectory.acceleration_at(trajectory.dense_times(2))).max(initial=1e-9))
        self._units = (trajectory.duration_s**-2, trajectory.duration_s**-1)  # of df/ds and df/dv
        self._speed = max(float(np.abs(trajectory.velocity).max()), 1e-9)
        self.failure = ""
        self.next_tube: ErrorTube | None = None

    def takes(self, states: tuple[State, State], at: tuple[float, float], halvings: int, order: int) -> bool:
        """Add the bounds on a box (centre and radius in tau); return False if the box must first be halved."""
        if self.failure:
            return True
        piece = states[0].piece
        if piece.kinetics != ("of_position",):
            self.failure = "the planned velocity is not the slope of the planned position"
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

    def radii(self) -> np.ndarray:
        """Return the distance (2 n_s,) from the plan within which exactly one motion of the model exists.

        Raises:
            NoMotionError: if the theorem's conditions do not hold.
        """
        if self.failure:
            raise NoMotionError(self.failure)
        bounds, contraction = contracted(self._boxes, self._n_s)
        with np.errstate(over="ignore"):  # bounds of what grows without end
            tube = bounds / (1 - MAX_CONTRACTION)
            # A wider tube is hopeless where Z, which grows with it at most in proportion, is expected above one.
            wider = float((tube / self._tube.radii).mean(axis=0).max())
        if self._tube.is_guess and (wider < 1 or wider * contraction < 1):
            self.next_tube = ErrorTube(until_s=np.array([box.end_s for box in self._boxes]), radii=tube)
        if not contraction <= MAX_CONTRACTION:
            raise NoMotionError(f"the contraction is {contraction:.2g}, which is above {MAX_CONTRACTION:g}")
        radii = bounds / (1 - contraction)
        if not all(np.all(radius <= box.tube) for radius, box in zip(radii, self._boxes, strict=True)):
            share = float((radii[-1] / self._sizes).max())
            raise NoMotionError(f"the bound on its distance is {share:.2g} of the motion's span or largest speed")
        return radii[-1]

    def findings(self) -> list[Finding]:
        """Return the findings on the distance of the model's own motion from the plan, in each position and velocity."""
        try:
            near = self.radii()
        except NoMotionError as error:
            return [no_motion(str(error))]
        found, speed = [], VELOCITY_SHARE * self._speed
        for joint, *radii in zip(self._mechanism.independent_joints, near[: self._n_s], near[self._n_s :], strict=True):
            allowed = np.radians(INTEGRATION_DEG) if joint.kind == "hinge" else INTEGRATION_M
            for what, per, radius, mark in zip(("position", "speed"), ("", "/s"), radii, (allowed, speed), strict=True):
                bound, most = joint.shown(float(radius)), joint.shown(float(mark))
                answer = "proved" if bound <= most else "sampled"
                reason = "" if bound <= most else f"a motion is proved within {bound:.3g} {joint.unit}{per} only"
                shared = {"unit": joint.unit + per, "bound": bound, "mark": most, "margin": most - bound}
                named = f"{OWN_MOTION}: distance from the planned {what} of {joint.name}"
                found.append(Finding(name=named, answer=answer, boxes=len(self._boxes), reason=reason, **shared))
        return found

    def _defect(self, states: tuple[State, State], order: int) -> list[TaylorForm]:
        """Return the forms of the defect d = M_r^-1 r (n_s,) of the planned motion on a box."""
        inertia, found = _model_of(self._mechanism)[0], []
        for state, cap in zip(states, (order + 2, order + 3), strict=True):
            ctx.cap = cap
            found += solve_enclosed(inertia(state.q)[0], [state.of_position.residual])
        return [TaylorForm.of(a, b, order) for a, b in zip(*found, strict=True)]

    def _box(self, states: tuple[State, State], at: tuple[float, float], defect, forms) -> LinearBox:
        """Return a box; the coefficients of A are the midpoints of those of the forms of dF/dy."""
        slopes = [[[float(c.mid()) for c in form.coefficients] for form in row] for row in forms]
        variation = [
            [size_of(form.coefficients, middles) + form.remainder for form, middles in zip(*rows, strict=True)]
            for rows in zip(forms, slopes, strict=True)
        ]
        if not all(x.is_finite() for x in (*(form.remainder for form in defect), *(y for row in variation for y in row))):
            raise NotSeparatedError("a slope is not bounded")
        piece = states[0].piece
        jump = [arb(0)] * (2 * self._n_s)
        if self._last not in (None, piece):
            jump = [abs(x - y) for x, y in zip(_state(piece, 0), _state(self._last, 1), strict=True)]
        width, end = piece.width * arb(2 * at[1]), _end_s(piece, at)
        shared = {"end_s": end, "tube": self._tube.at(end)}
        return LinearBox(**shared, width=width, slopes=slopes, variation=variation, defect=defect, jump=jump)

    def _slopes(self, states: tuple[State, State], at: tuple[float, float]) -> list[list[TaylorForm]]:
        """Return the forms of df/d(s, v) (n_s, 2 n_s) on a box, for all states within the tube."""
        blocks, piece, n_s, found = states[0].blocks, states[0].piece, self._n_s, []
        along, rate = arb_poly([arb(at[0]), arb(at[1])]), 1 / (piece.width * arb(at[1]))
        curves = [[p(along) for p in piece.effort], [p(along) for p in piece.position]]  # u, s, v, a of x in [-1, 1]
        for _ in range(2):
            curves.append([rate * p.derivative() for p in curves[-1]])
        balls = [arb(0, float(x)) for x in self._tube.at(_end_s(piece, at))]
        guess = np.array([float(constant_term(z).mid()) for z in states[0].z])
        for x, cap in ((arb(0), _SLOPE_ORDER), (arb(0, 1), _SLOPE_ORDER + 1)):
            ctx.cap, about = cap, arb_poly([x, 1])
            u, s, v, a = ([arb_series(p(about).coeffs(), prec=cap) for p in curve] for curve in curves)
            s, v = ([p + e for p, e in zip(*pair, strict=True)] for pair in ((s, balls[:n_s]), (v, balls[n_s:])))
            root = krawczyk(blocks, [constant_term(one) for one in s], guess)
            q = pose_of(blocks, s, series_of(blocks, s, root.enclosure, cap))
            time = arb_series((piece.since + piece.width * along)(about).coeffs(), prec=cap)
            forces = [] if self._mechanism.forces is None else forces_over(self._mechanism.forces, time)
            found.append(_slopes_at(self._mechanism, q, v, a, u, forces))
        if not all(region.contains(z[0]) for region, z in zip(root.region, states[1].z, strict=True)):
            raise NotSeparatedError("the branch is not known to be the plan's")
        return [
            [TaylorForm.of(at, over, _SLOPE_ORDER) for at, over in zip(*rows, strict=True)]
            for rows in zip(*found, strict=True)
        ]

    def _is_small(self, defect: Sequence[TaylorForm]) -> bool:
        """Return True if the bound on the defect would not become much smaller on a shorter box."""
        least = _DEFECT_SHARE * self._acceleration
        return all(form.remainder <= max(least, above(size_of(form.coefficients)) / 4) for form in defect)

    def _is_tight(self, slopes: Sequence[Sequence[TaylorForm]]) -> bool:
        """Return True if a shorter box would not bound dF/dy much better, because the tube's width dominates."""
        n_s = self._n_s
        for k, unit in zip((0, n_s), self._units, strict=True):
            entries = [form for row in slopes for form in row[k : k + n_s]]
            size = max(unit, *(abs(float(form.coefficients[0].mid())) for form in entries))
            if not all(form.remainder <= size for form in entries):
                return False
        return True


def _state(piece: Piece, tau: float) -> list[arb]:
    """Return the planned positions and their derivatives (2 n_s,) at an end of an interval."""
    return [p(arb(tau)) for p in piece.position] + [p.derivative()(arb(tau)) / piece.width for p in piece.position]


def _end_s(piece: Piece, at: tuple[float, float]) -> float:
    """Return the end [s] of the box with a given centre and radius in tau."""
    return piece.begin_s + sum(at) * float(piece.width)


def _sizes(trajectory: Trajectory) -> np.ndarray:
    """Return each coordinate's span and largest speed (2 n_s,), at least a share of the largest of all coordinates."""
    sizes = (np.ptp(trajectory.position, axis=(0, 1)), np.abs(trajectory.velocity).max(axis=(0, 1)))
    return np.concatenate([np.maximum(size, 1e-2 * size.max() + 1e-9) for size in sizes])


@functools.lru_cache(maxsize=16)
def _model_of(mechanism: Mechanism) -> tuple[Walk, Walk, Walk]:
    """Return three walks: q -> M_r; (q, v, a, u, forces) -> residual r; the same -> [dr/ds along the closure, dr/dv]."""
    dynamics, n_s = mechanism.dynamics, mechanism.dof
    names = (("q", mechanism.n_q), ("v", n_s), ("a", n_s), ("u", len(mechanism.actuators)))
    q, v, *_ = symbols = [*(ca.SX.sym(name, n) for name, n in names), *force_symbols(mechanism)]
    r = mechanism.forced.residual(*symbols)
    by = ca.horzcat(ca.jacobian(r, q) @ dynamics.velocity_map(q), ca.jacobian(r, v))
    residual, slopes = (walk_of(ca.Function(name, symbols, [of], {"cse": True})) for name, of in (("r", r), ("by", by)))
    return walk_of(dynamics.reduced_inertia), residual, slopes


def _slopes_at(mechanism: Mechanism, q, v, a, u, forces=()) -> list[list[Ball]]:
    """Return df/d(s, v) (n_s, 2 n_s) at pose q and velocity v; a (n_s,) may be any accelerations."""
    inertia_of, residual, slopes = _model_of(mechanism)
    inertia, n_s = inertia_of(q)[0], len(v)
    (defect,) = solve_enclosed(inertia, [dense(residual(q, v, a, u, *forces)[0], n_s)])
    by = slopes(q, v, [x - y for x, y in zip(a, defect, strict=True)], u, *forces)[0]
    columns = solve_enclosed(inertia, [[-x for x in dense(by, n_s, column)] for column in range(2 * n_s)])
    return [[column[i] for column in columns] for i in range(n_s)]
