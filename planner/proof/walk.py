"""Evaluation of a CasADi function on balls and truncated power series (a `Walk`), and the model's blocks for a proof.

A ball (flint's `arb`) is a midpoint with a radius that contains the exact real number; a series (`arb_series`) has balls as
coefficients (Johansson, IEEE Trans. Computers 66, 2017). The proof has no model of its own: it evaluates the expressions of
the mechanism's model. An operation with a kink (a minimum, a switch) is exact if its argument stays on one side of the kink.
Otherwise the result encloses both sides in as many coefficients as the function has bounded derivatives. The other
coefficients are infinite.

The planner's program contains the reduced dynamics as one long expression. Here closure, tree dynamics and moment arms are
separate blocks, connected by small linear systems. The cost therefore grows with the sum of their lengths, not the product.
"""

import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from flint import arb, arb_series

from linkplan.models.compiled.functions import on_arrays
from linkplan.models.mechanism import Mechanism

Ball = arb | arb_series

UNKNOWN = arb(0, math.inf)


class UnknownOperationError(ValueError):
    """An expression contains an operation for which the walk has no enclosure."""


def constant_term(x: Ball) -> arb:
    """Return the value of a ball, or of a series at the expansion point."""
    return x[0] if isinstance(x, arb_series) else x


def known_to(coefficients: list[arb], *like: Ball) -> Ball:
    """Return a series with these coefficients, followed by infinite ones; or a ball if no item of `like` is a series."""
    orders = [x.prec for x in like if isinstance(x, arb_series)]
    if not orders:
        return coefficients[0]
    n = min(orders)
    return arb_series((coefficients + [UNKNOWN] * n)[:n], prec=n)


def _slope(x: Ball) -> arb:
    return x[1] if isinstance(x, arb_series) else arb(0)


def larger(a: Ball, b: Ball) -> Ball:
    """Return the larger of two numbers at every point."""
    low, high = constant_term(a), constant_term(b)
    if low >= high:
        return a
    return b if high >= low else known_to([low.max(high), _slope(a).union(_slope(b))], a, b)


def _signed_square(a: Ball, _: Ball) -> Ball:
    """Return a |a|, whose second derivative is bounded where a changes sign."""
    value, square = constant_term(a), a * a
    if value >= 0 or value <= 0:
        return square if value >= 0 else -square
    signed = (value.upper() ** 2).union(-(value.lower() ** 2))
    if not isinstance(square, arb_series):
        return signed
    return known_to([signed, 2 * a[1] * abs(value), square[2].union(-square[2])], a)


def _sign(a: Ball, _: Ball) -> Ball:
    value = constant_term(a)
    return arb(1) if value > 0 else arb(-1) if value < 0 else known_to([arb(0, 1)], a)


def _less(a: Ball, b: Ball) -> Ball:
    """Return a < b as 1 or 0, or as the ball [0, 1] if the balls overlap."""
    low, high = constant_term(a), constant_term(b)
    return arb(1) if low < high else arb(0) if low >= high else known_to([arb(0.5, 0.5)], a, b)


def _floor(a: Ball, _: Ball) -> Ball:
    value = constant_term(a).floor()
    return value if value.is_exact() else known_to([value], a)


def _chosen(condition: Ball, a: Ball) -> Ball:
    """Return a if the condition is 1, and zero if it is 0."""
    value = constant_term(condition)
    if value == 1:
        return a
    return arb(0) if value == 0 else known_to([constant_term(a).union(arb(0))], a)


def _power(a: Ball, b: Ball) -> Ball:
    if isinstance(b, arb) and b.is_integer() and abs(b) <= 64:
        n = int(float(b))
        return a**n if n >= 0 else 1 / a ** (-n)
    return (b * a.log()).exp()


def _tanh(a: Ball, _: Ball) -> Ball:
    if isinstance(a, arb):
        return a.tanh()
    t = [a[0].tanh()]  # and k t_k = sum_j j a_j c_(k - j) with c = 1 - t^2, from t' = (1 - t^2) a'
    c = [1 - t[0] * t[0]]
    for k in range(1, a.prec):
        t.append(sum((j * a[j] * c[k - j] for j in range(1, k + 1)), arb(0)) / k)
        c.append(-sum((t[i] * t[k - i] for i in range(k + 1)), arb(0)))
    return arb_series(t, prec=a.prec)


def _sinh(a: Ball, _: Ball) -> Ball:
    grown = a.exp()
    return (grown - 1 / grown) / 2


def _cosh(a: Ball, _: Ball) -> Ball:
    grown = a.exp()
    return (grown + 1 / grown) / 2


def _atan2(y: Ball, x: Ball) -> Ball:
    angle = arb.atan2(constant_term(y), constant_term(x))
    if isinstance(x, arb) and isinstance(y, arb):
        return angle
    x, y = (one if isinstance(one, arb_series) else arb_series([one]) for one in (x, y))
    return angle + ((x * y.derivative() - y * x.derivative()) / (x * x + y * y)).integral()


def _unary(name: str) -> Callable[[Ball, Ball], Ball]:
    method = operator.methodcaller(name)
    return lambda a, _: method(a)


_OPERATIONS: dict[int, Callable] = {
    ca.OP_ASSIGN: lambda a, _: a,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: lambda a, _: -a,
    ca.OP_TWICE: operator.add,  # a + a
    ca.OP_SQ: operator.mul,
    ca.OP_INV: lambda a, _: 1 / a,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SINH: _sinh,
    ca.OP_COSH: _cosh,
    ca.OP_TANH: _tanh,
    ca.OP_ATAN2: _atan2,
    ca.OP_FABS: lambda a, _: larger(a, -a),
    ca.OP_SIGN: _sign,
    ca.OP_FLOOR: _floor,
    ca.OP_FMAX: larger,
    ca.OP_FMIN: lambda a, b: -larger(-a, -b),
    ca.OP_LT: _less,
    ca.OP_LE: lambda a, b: 1 - _less(b, a),
    ca.OP_NOT: lambda a, _: 1 - a,
    ca.OP_AND: operator.mul,
    ca.OP_OR: lambda a, b: a + b - a * b,
    ca.OP_IF_ELSE_ZERO: _chosen,
    **{
        getattr(ca, f"OP_{name.upper()}"): _unary(name)
        for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan")
    },
}


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Walk:
    """A CasADi function over SX as a list of operations on balls.

    `steps` are (operation, result slot, first slot, second slot) in order. `inputs` are (slot, input, entry), `constants`
    (slot, value). `outputs` lists for each output the slot of each nonzero entry, `places` its (row, column).
    """

    steps: tuple[tuple, ...]
    inputs: tuple[tuple[int, int, int], ...]
    constants: tuple[tuple[int, arb], ...]
    n_slots: int
    outputs: tuple[tuple[int, ...], ...]
    places: tuple[tuple[tuple[int, int], ...], ...]

    def __call__(self, *arguments: Sequence[Ball]) -> list[dict[tuple[int, int], Ball]]:
        """Return the nonzero entries of every output by (row, column); each argument lists all entries of a dense input."""
        slots: list = [None] * self.n_slots
        for slot, value in self.constants:
            slots[slot] = value
        for slot, of, entry in self.inputs:
            slots[slot] = arguments[of][entry]
        for operation, result, a, b in self.steps:
            slots[result] = operation(slots[a], slots[b])
        return [
            {place: slots[slot] for place, slot in zip(places, of, strict=True)}
            for places, of in zip(self.places, self.outputs, strict=True)
        ]


@functools.lru_cache(maxsize=256)
def walk_of(function: ca.Function) -> Walk:
    """Return the walk of a function over SX with dense inputs.

    Raises:
        UnknownOperationError: if the function contains an operation without an enclosure.
    """
    steps, inputs, constants = [], [], []
    outputs = [[-1] * function.nnz_out(k) for k in range(function.n_out())]
    magnitudes: dict[int, int] = {}  # slot of |x| -> slot of x: x |x| is smoother than |x|
    slot_of, n = {}, 0  # by place in CasADi's work vector; CasADi uses a place again, here each result has its own slot
    for k in range(function.n_instructions()):
        code, taken, given = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            outputs[given[0]][given[1]] = slot_of[taken[0]]
            continue
        if code == ca.OP_CONST:
            constants.append((n, arb(function.instruction_constant(k))))
        elif code == ca.OP_INPUT:
            inputs.append((n, taken[0], taken[1]))
        elif code in _OPERATIONS:
            slots = [slot_of[place] for place in taken]
            damped = (
                [one for one, other in (slots, slots[::-1]) if magnitudes.get(other) == one] if code == ca.OP_MUL else []
            )
            steps.append(
                (_signed_square, n, damped[0], damped[0]) if damped else (_OPERATIONS[code], n, slots[0], slots[-1])
            )
            if code == ca.OP_FABS:
                magnitudes[n] = slots[0]
        else:
            raise UnknownOperationError(f"operation {code} of {function.name()}")
        slot_of[given[0]] = n
        n += 1
    triplets = [function.sparsity_out(k).get_triplet() for k in range(function.n_out())]
    return Walk(
        steps=tuple(steps),
        inputs=tuple(inputs),
        constants=tuple(constants),
        n_slots=n,
        outputs=tuple(tuple(of) for of in outputs),
        places=tuple(tuple(zip(rows, columns, strict=True)) for rows, columns in triplets),
    )


def dense(entries: dict[tuple[int, int], Ball], n_rows: int, column: int = 0) -> list[Ball]:
    """Return a column of an output as a list, with zeros where it has no entry."""
    zero = arb(0)
    return [entries.get((row, column), zero) for row in range(n_rows)]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Blocks:
    """The model's blocks as walks, and the closure as a function of numbers.

    `closure` is q -> E phi (rank,), `tangent` is q -> d(E phi)/dq (rank, n_q), `tree` is (q, q', q'', forces over time) ->
    generalised forces (n_q,) of the tree with open loops, `arms` is q -> B (n_q, n_u), `convective` is (q, q') -> J' q'
    (rank,). `force_map` is q -> the matrix (n_rows, rank) from multipliers to the forces of least norm on all rows.
    """

    mechanism: Mechanism
    independent: tuple[int, ...]
    dependent: tuple[int, ...]
    closure: Walk
    tangent: Walk
    numbers: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # q -> E phi (rank,), J (rank, n_q)
    tree: Walk
    arms: Walk
    convective: Walk
    force_map: Walk
    n_rows: int

    @property
    def rank(self) -> int:
        """The number of dependent coordinates."""
        return len(self.dependent)


@functools.lru_cache(maxsize=16)
def blocks_of(mechanism: Mechanism) -> Blocks:
    """Return the blocks of a mechanism.

    Raises:
        UnknownOperationError: if the model contains an operation without an enclosure.
    """
    dynamics = mechanism.dynamics
    q, rates, _ = motion = [ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd")]
    forces = force_symbols(mechanism)
    phi = dynamics.independent_closure(q)
    jacobian = ca.jacobian(phi, q)
    return Blocks(
        mechanism=mechanism,
        independent=tuple(int(i) for i in mechanism.independent),
        dependent=tuple(int(i) for i in mechanism.dependent),
        closure=_walk("closure", [q], phi),
        tangent=_walk("tangent", [q], jacobian),
        numbers=_in_numbers(ca.Function("numbers", [q], [ca.densify(phi), ca.densify(jacobian)])),
        tree=_walk("tree", [*motion, *forces], mechanism.forced.tree_effort(*motion, *forces)),
        arms=_walk("arms", [q], ca.sparsify(dynamics.effort_matrix(q))),
        convective=_walk("convective", [q, rates], ca.jtimes(jacobian @ rates, q, rates)),
        force_map=_walk("force_map", [q], ca.sparsify(dynamics.force_map(q))),
        n_rows=mechanism.n_closure_rows,
    )


def _walk(name: str, inputs: list[ca.SX], output: ca.SX) -> Walk:
    """Return the walk of an expression, with common subexpressions evaluated once."""
    return walk_of(ca.Function(name, inputs, [output], {"cse": True}))


def _in_numbers(function: ca.Function) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return a CasADi function of the pose as a function on arrays, which returns its outputs, a column and a matrix."""
    pose, column = np.empty(function.numel_in(0)), np.empty(function.numel_out(0))
    matrix = np.empty(function.size_out(1), order="F")
    entries = matrix.reshape(-1, order="F")
    evaluate = on_arrays(function, [pose], [column, entries])

    def numbers(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose[:] = q
        evaluate()
        return column.copy(), matrix.copy()

    return numbers


@functools.lru_cache(maxsize=64)
def pose_walk(mechanism: Mechanism, name: str) -> tuple[Walk, int]:
    """Return the walk of a column of the reduced dynamics that depends only on the pose, and its number of rows."""
    q, function = ca.SX.sym("q", mechanism.n_q), getattr(mechanism.dynamics, name)
    return _walk(name, [q], ca.densify(function(q))), function.size1_out(0)


@functools.lru_cache(maxsize=16)
def loaded_tree(mechanism: Mechanism, values: tuple[float, ...]) -> Walk:
    """Return the walk of the tree (see `Blocks`) with values (n,) [SI] of the mechanism's parameters."""
    symbols = [ca.SX.sym(name, mechanism.n_q) for name in ("q", "qd", "qdd")]
    forces = force_symbols(mechanism)
    loaded = mechanism.parametric_dynamics().tree_effort(*symbols, ca.vertcat(ca.DM(values), *forces))
    return _walk("loaded_tree", [*symbols, *forces], ca.densify(loaded))


def force_symbols(mechanism: Mechanism) -> list[ca.SX]:
    """Return the symbols of the external forces, the last inputs of a mechanism's `forced` dynamics."""
    return [] if mechanism.forces is None else [ca.SX.sym("forces", 3 * len(mechanism.forces.sites))]
