"""Keys of compiled interval functions in the cache of `models/compiled`.

The functions are small (one node, one interval) and serve a mesh of any size. They form two libraries. The node's functions
depend only on the structure of the mechanism and the objective, not on their numbers (`numbers.py`) or the transcription.
The chain rule's functions depend on the transcription and the sizes alone. One compilation of half a second therefore serves
every later solve of mechanisms of one structure, whatever their lengths and masses. A cached library is found before
derivatives are built, because the key hashes only the node's expressions or the sizes.
"""

import functools
import hashlib
from dataclasses import fields
from pathlib import Path

from linkplan.models.compiled.functions import tools_hash
from linkplan.planner.transcription.interval import IntervalRows, open_end_path
from linkplan.planner.transcription.node import NodeFunctions
from linkplan.planner.transcription.schemes import Scheme
from linkplan.planner.transcription.system import System


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
