"""A system without its numbers: what is left is its structure, and one compilation serves every system that has it.

Masses, lengths and all else that a model says stand in a node's expressions as constants. Taken out, they are parameters of
a node: mechanisms of one kind (every four-bar of a design study) then have the same functions, compiled once for all.
"""

import functools
from dataclasses import replace

import casadi as ca
import numpy as np

from linkplan.planner.transcription.system import System

# Constants are taken out where they are summands, factors or divisors alone: an exponent, or what is compared with, decides
# what derivatives look like.
_TAKEN = (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV)
# Constants of the equations and not of the model, and by how much a model's number may be off one of them by rounding: a
# rotation's entry that is one for one mechanism and one less a rounding for the next is one for both.
_OF_THE_EQUATIONS, _ROUNDING = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0]), 4e-16


@functools.lru_cache(maxsize=32)
def without_numbers(system: System) -> tuple[System, np.ndarray]:
    """Return a system with the numbers of its node's expressions as further parameters, its last ones, and these (n,).

    A user's differential equation, of one problem and not of a family, is returned as it is, without any; so is a system
    that calls functions of its own.
    """
    node = system.node
    if not system.n_s or not node.is_a("SXFunction") or ca.OP_CALL in map(node.instruction_id, range(node.n_instructions())):
        return system, np.zeros(0)
    xi, theta = ca.SX.sym("xi", system.n_xi), ca.SX.sym("theta", system.n_theta)
    given = (ca.vertsplit(xi), ca.vertsplit(theta))
    taken = _taken(node)
    symbols = ca.SX.sym("numbers", len(taken))
    name = dict(zip(taken, ca.vertsplit(symbols) if taken else [], strict=True))
    work: list[ca.SX] = [ca.SX(0)] * node.sz_w()
    column = ca.SX(node.sparsity_out(0))
    values: list = [ca.SX(0)] * column.nnz()
    for k in range(node.n_instructions()):
        op, out, into = node.instruction_id(k), node.instruction_output(k), node.instruction_input(k)
        if op == ca.OP_OUTPUT:
            values[out[1]] = work[into[0]]
        elif op == ca.OP_INPUT:
            work[out[0]] = given[into[0]][into[1]]
        elif op == ca.OP_CONST:
            work[out[0]] = name[k] if k in name else ca.SX(_rounded(node.instruction_constant(k)))
        elif len(into) == 1:
            work[out[0]] = ca.SX.unary(op, work[into[0]])
        else:
            work[out[0]] = ca.SX.binary(op, work[into[0]], work[into[1]])
    column = ca.SX(node.sparsity_out(0), ca.vertcat(*values))
    numbers = np.array([node.instruction_constant(k) for k in taken])
    return replace(system, node=ca.Function("node", [xi, ca.vertcat(theta, symbols)], [column])), numbers


def _taken(node: ca.Function) -> list[int]:
    """Return the instructions of a function whose constants are a model's numbers."""
    standing: dict[int, int] = {}  # the instruction whose constant a place of the work vector holds
    kept: set[int] = set()
    taken = []
    for k in range(node.n_instructions()):
        op, out = node.instruction_id(k), node.instruction_output(k)
        if op != ca.OP_INPUT and op not in _TAKEN:
            kept |= {standing[place] for place in node.instruction_input(k) if place in standing}
        if op == ca.OP_OUTPUT:
            continue
        standing.pop(out[0], None)
        if op == ca.OP_CONST and _of_a_model(node.instruction_constant(k)):
            standing[out[0]] = k
            taken.append(k)
    return [k for k in taken if k not in kept]


def _rounded(constant: float) -> float:
    """Return a constant, or the one of the equations that it is but for rounding."""
    nearest = float(_OF_THE_EQUATIONS[np.argmin(np.abs(_OF_THE_EQUATIONS - constant))])
    return nearest if abs(nearest - constant) <= _ROUNDING * abs(nearest) else constant


def _of_a_model(constant: float) -> bool:
    """Return whether a constant is none of the equations'."""
    return bool(np.isfinite(constant)) and _rounded(constant) not in _OF_THE_EQUATIONS
