"""Functions that are compiled once for all systems of one structure: their keys in the cache, and constants as parameters.

The functions are small (one node, one interval) and serve a mesh of any size. They form two libraries. The node's functions
depend only on the structure of the mechanism and the objective, not on their numbers or the transcription: masses, lengths
and other constants of a node's expressions become parameters of the node (`without_numbers`). The chain rule's functions
depend on the transcription and the sizes alone. One compilation of half a second therefore serves every later solve of
mechanisms of one structure, whatever their lengths and masses (every four-bar of a design study). A cached library is found
before derivatives are built, because the key hashes only the node's expressions or the sizes.
"""

import functools
import hashlib
from dataclasses import fields, replace
from pathlib import Path

import casadi as ca
import numpy as np

from linkplan.models.compiled.functions import tools_hash
from linkplan.planner.transcription.interval import IntervalRows, open_end_path
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import NodeFunctions, System

# Only constants that are summands, factors or divisors become parameters. Exponents and compared constants determine the
# form of the derivatives and stay.
_REPLACED_OPERATIONS = (ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_DIV)
# Constants of the equations, not of the model. A model's number that equals one of them except for rounding counts as
# equal: an entry of a rotation may be 1 in one mechanism and 1 - 1e-16 in the next.
_EQUATION_CONSTANTS = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])


@functools.lru_cache(maxsize=32)
def without_numbers(system: System) -> tuple[System, np.ndarray]:
    """Return a system with its node's constants as further parameters, and the values (n,) of these parameters.

    A user's differential equation is returned unchanged, because it is one problem and not a family. So is a system whose
    expressions call functions.
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
    """Return the indices of the instructions that load a model's numbers."""
    standing: dict[int, int] = {}  # the instruction whose constant a place of the work vector holds
    kept: set[int] = set()
    taken = []
    for k in range(node.n_instructions()):
        op, out = node.instruction_id(k), node.instruction_output(k)
        if op != ca.OP_INPUT and op not in _REPLACED_OPERATIONS:
            kept |= {standing[place] for place in node.instruction_input(k) if place in standing}
        if op == ca.OP_OUTPUT:
            continue
        standing.pop(out[0], None)
        if op == ca.OP_CONST and _is_model_number(node.instruction_constant(k)):
            standing[out[0]] = k
            taken.append(k)
    return [k for k in taken if k not in kept]


def _rounded(constant: float) -> float:
    """Return a constant, replaced by the constant of the equations that it equals except for rounding."""
    nearest = float(_EQUATION_CONSTANTS[np.argmin(np.abs(_EQUATION_CONSTANTS - constant))])
    return nearest if abs(nearest - constant) <= 4e-16 * abs(nearest) else constant


def _is_model_number(constant: float) -> bool:
    """Check that a constant is finite and no constant of the equations."""
    return bool(np.isfinite(constant)) and _rounded(constant) not in _EQUATION_CONSTANTS


@functools.lru_cache(maxsize=32)
def node_key(system: System, at_open_ends: tuple[int, ...] = ()) -> str:
    """Return the cache key of a node's functions: a hash of its expressions and of the tools that compile them."""
    digest = hashlib.sha256(tools_hash(Path(__file__).parent))
    digest.update(system.node.serialize().encode())
    digest.update(repr(("node", *_sizes(system), system.n_theta, system.kinds, at_open_ends)).encode())
    return f"k{digest.hexdigest()[:32]}"  # begins with a letter, because CasADi makes an identifier of it


def chain_key(system: System, scheme: Scheme, rows: IntervalRows, node: NodeFunctions) -> str:
    """Return the cache key of the chain rule's functions: a hash of sizes, patterns and constants, without expressions."""
    digest = hashlib.sha256(tools_hash(Path(__file__).parent))
    digest.update(repr(("chain", *_sizes(system), rows, open_end_path(scheme, rows))).encode())
    digest.update(repr((node.open_end_rows, node.open_end_z, scheme.name, scheme.effort_at.tolist())).encode())
    for field in fields(NodeFunctions):
        if field.name.endswith("pattern"):
            digest.update(repr([part.tolist() for part in getattr(node, field.name)]).encode())
    return f"k{digest.hexdigest()[:32]}"


def _sizes(system: System) -> tuple[int, ...]:
    return (system.n_s, system.n_x, system.n_z, system.n_u, system.n_equations, system.n_path)
