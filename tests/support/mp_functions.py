"""CasADi functions and motions evaluated by mpmath: a second route to every number that a proof encloses."""

import functools
import itertools
import math
import operator

import casadi as ca
import mpmath as mp
import numpy as np
from flint import arb

from linkplan.models.mechanism import Mechanism
from linkplan.planner.trajectory import Trajectory

DIGITS = 50
_OPERATIONS = {
    ca.OP_ASSIGN: lambda a, _: a,
    ca.OP_ADD: operator.add,
    ca.OP_SUB: operator.sub,
    ca.OP_MUL: operator.mul,
    ca.OP_DIV: operator.truediv,
    ca.OP_NEG: lambda a, _: -a,
    ca.OP_TWICE: lambda a, _: 2 * a,
    ca.OP_SQ: lambda a, _: a * a,
    ca.OP_INV: lambda a, _: 1 / a,
    ca.OP_SQRT: lambda a, _: mp.sqrt(a),
    ca.OP_SIN: lambda a, _: mp.sin(a),
    ca.OP_COS: lambda a, _: mp.cos(a),
    ca.OP_FABS: lambda a, _: abs(a),
    ca.OP_FMAX: max,
    ca.OP_FMIN: min,
    ca.OP_LT: lambda a, b: mp.mpf(a < b),
    ca.OP_LE: lambda a, b: mp.mpf(a <= b),
    ca.OP_NOT: lambda a, _: 1 - a,
    ca.OP_IF_ELSE_ZERO: lambda a, b: b if a else mp.mpf(0),
}


@functools.cache
def _instructions(function: ca.Function) -> list[tuple]:
    """Return a function's instructions: code, result, inputs, constant."""
    found = []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        constant = mp.mpf(function.instruction_constant(k)) if code == ca.OP_CONST else None
        found.append((code, function.instruction_output(k), function.instruction_input(k), constant))
    return found


def mp_values(function: ca.Function, *arguments) -> list:
    """Return the entries of a function's first output, column by column, from lists of numbers."""
    slots, found = {}, [mp.mpf(0)] * function.numel_out(0)
    sparsity = function.sparsity_out(0)
    places = [row + column * sparsity.size1() for row, column in zip(*sparsity.get_triplet(), strict=True)]
    for code, given, taken, constant in _instructions(function):
        if code == ca.OP_OUTPUT:
            if given[0] == 0:
                found[places[given[1]]] = slots[taken[0]]
        elif code == ca.OP_CONST:
            slots[given[0]] = constant
        elif code == ca.OP_INPUT:
            slots[given[0]] = arguments[taken[0]][taken[1]]
        else:
            slots[given[0]] = _OPERATIONS[code](slots[taken[0]], slots[taken[-1]])
    return found


def mp_motion(trajectory: Trajectory, interval: int, tau) -> tuple[list, list, list]:
    """Return s, s' and s'' at a share of an interval."""
    h = mp.mpf(trajectory.breaks_s[interval + 1]) - mp.mpf(trajectory.breaks_s[interval])
    coefficients = [[mp.mpf(x) for x in row] for row in trajectory.position[:, interval].T.tolist()]
    found = []
    for order in range(3):
        found.append([_bernstein(c, tau) / h**order for c in coefficients])
        coefficients = [[(len(c) - 1) * (b - a) for a, b in itertools.pairwise(c)] for c in coefficients]
    return found[0], found[1], found[2]


def _bernstein(c: list, t):
    n = len(c) - 1
    return sum(math.comb(n, k) * t**k * (1 - t) ** (n - k) * x for k, x in enumerate(c))


def mp_pose(mechanism: Mechanism, s: list, near: np.ndarray) -> list:
    """Return the closed pose by Newton's method with the Jacobian near it, in double precision."""
    q = [mp.mpf(x) for x in near.tolist()]
    for index, value in zip(mechanism.independent.tolist(), s, strict=True):
        q[index] = value
    J = np.array(mechanism.dynamics.closure_jacobian(near))[mechanism.closure_rows][:, mechanism.dependent]
    inverse = np.linalg.inv(J).tolist()
    for _ in range(60):
        phi = mp_values(mechanism.dynamics.independent_closure, q)
        if all(abs(x) < mp.mpf(10) ** (3 - DIGITS) for x in phi):
            break
        for row, index in zip(inverse, mechanism.dependent.tolist(), strict=True):
            q[index] -= sum(mp.mpf(c) * x for c, x in zip(row, phi, strict=True))
    return q


def mp_effort(mechanism: Mechanism, q: list, v: list, a: list) -> list:
    """Return the reduced efforts Gamma^T B u of a motion, by the planner's own long expression."""
    return mp_values(mechanism.dynamics.inverse_dynamics, q, v, a)


def ball(x) -> arb:
    """Return the ball of a number of mpmath, wider than its own rounding."""
    sign, mantissa, exponent, _ = mp.mpf(x)._mpf_
    return arb(-int(mantissa) if sign else int(mantissa)) * arb(2) ** exponent
