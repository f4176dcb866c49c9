"""The walk of a CasADi function: the same operations on balls and on truncated power series.

A ball (flint's `arb`) is a midpoint with a radius that contains the exact real number; a series (`arb_series`) has balls as
coefficients (Johansson, IEEE Trans. Computers 66, 2017). The expressions of the model are the only model: nothing is
written twice. An operation with a kink (a minimum, a switch) is exact where its argument stays on one side. Where it does
not, the value is enclosed by both sides and the derivatives are unknown.
"""

import functools
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
from flint import arb, arb_series

Ball = arb | arb_series

UNKNOWN = arb(0, math.inf)


class UnknownOperationError(ValueError):
    """An expression has an operation that the walk does not enclose."""


def constant_term(x: Ball) -> arb:
    """Return the value of a ball, or of a series at the expansion point."""
    return x[0] if isinstance(x, arb_series) else x


def _without_derivatives(value: arb, *like: Ball) -> Ball:
    """Return a value whose derivatives are unknown, as a series if one of `like` is a series."""
    orders = [x.prec for x in like if isinstance(x, arb_series)]
    return arb_series([value] + [UNKNOWN] * (min(orders) - 1), prec=min(orders)) if orders else value


def _larger(a: Ball, b: Ball) -> Ball:
    low, high = constant_term(a), constant_term(b)
    if low >= high:
        return a
    return b if high >= low else _without_derivatives(low.max(high), a, b)


def _smaller(a: Ball, b: Ball) -> Ball:
    return -_larger(-a, -b)


def _magnitude(a: Ball, _: Ball) -> Ball:
    return _larger(a, -a)


def _sign(a: Ball, _: Ball) -> arb:
    value = constant_term(a)
    return arb(1) if value > 0 else arb(-1) if value < 0 else arb(0, 1)


_UNCERTAIN = arb(0.5, 0.5)  # the ball [0, 1] of a comparison that the balls do not decide


def _less(a: Ball, b: Ball) -> arb:
    low, high = constant_term(a), constant_term(b)
    return arb(1) if low < high else arb(0) if low >= high else _UNCERTAIN


def _at_most(a: Ball, b: Ball) -> arb:
    return 1 - _less(b, a)


def _chosen(condition: Ball, a: Ball) -> Ball:
    """Return a where the condition is 1 and zero where it is 0."""
    value = constant_term(condition)
    if value == 1:
        return a
    return arb(0) if value == 0 else _without_derivatives(constant_term(a).union(arb(0)), a)


def _power(a: Ball, b: Ball) -> Ball:
    if isinstance(b, arb) and b.is_integer() and abs(b) <= 64:
        n = int(float(b))
        return a**n if n >= 0 else 1 / a ** (-n)
    return (b * a.log()).exp()


def _tanh(a: Ball, _: Ball) -> Ball:
    return a.tanh() if isinstance(a, arb) else 1 - 2 / ((2 * a).exp() + 1)


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
    ca.OP_TWICE: lambda a, _: a + a,
    ca.OP_SQ: lambda a, _: a * a,
    ca.OP_INV: lambda a, _: 1 / a,
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_SINH: _sinh,
    ca.OP_COSH: _cosh,
    ca.OP_TANH: _tanh,
    ca.OP_ATAN2: _atan2,
    ca.OP_FABS: _magnitude,
    ca.OP_SIGN: _sign,
    ca.OP_FMAX: _larger,
    ca.OP_FMIN: _smaller,
    ca.OP_LT: _less,
    ca.OP_LE: _at_most,
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
        """Return every output's nonzero entries by (row, column); each argument has the entries of a dense input."""
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
        UnknownOperationError: for an operation without an enclosure.
    """
    steps, inputs, constants = [], [], []
    outputs = [[-1] * function.nnz_out(k) for k in range(function.n_out())]
    slot_of, n = {}, 0  # of CasADi's work vector, whose places are used again; here every result has its own slot
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
            steps.append((_OPERATIONS[code], n, slots[0], slots[-1]))
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
