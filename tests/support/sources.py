"""The product's source files as syntax trees: who imports whom, and which numbers stand in them."""

import ast
import functools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Each package may import those before it: models <- planner <- controllers <- studies.
PACKAGES = ("models", "planner", "controllers", "studies")
# The public package, above everything; its rooms `api` and `cli` are its own folders, the four packages are links in it.
PUBLIC = ROOT / "linkplan"
SOURCES = sorted(
    [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    + [path for folder in (".", "api", "cli") for path in (PUBLIC / folder).glob("*.py")]
)
# Numbers that say nothing by themselves where they stand in an expression.
PLAIN = (0, 1, 2)


def module_of(path: Path) -> str:
    """Return the name under which a source file is imported."""
    parts = path.relative_to(PUBLIC if path.is_relative_to(PUBLIC) else ROOT).with_suffix("").parts
    return ".".join(("linkplan", *(parts[:-1] if parts[-1] == "__init__" else parts)))


MODULES = {module_of(path): path for path in SOURCES}


@functools.cache
def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@functools.cache
def imports(path: Path) -> frozenset[str]:
    """Return the modules that a file imports, ours to the file."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            deeper = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in deeper}
    return frozenset(found)


def room_of(module: str) -> tuple[str, str] | None:
    """Return a module's package and room; None for the public package and what is not ours."""
    parts = module.split(".")
    if parts[0] != "linkplan" or len(parts) < 3 or parts[1] not in PACKAGES:
        return None
    return parts[1], parts[2]


def arrows() -> Counter:
    """Return how many imports lead from one room into another, file by file."""
    found = Counter()
    for module, path in MODULES.items():
        for other in imports(path):
            ends = room_of(module), room_of(other)
            if None not in ends and ends[0] != ends[1]:
                found[ends] += 1
    return found


def is_number(node: ast.expr) -> bool:
    """Return True for a number, and for a sum, product or shift of numbers."""
    if isinstance(node, ast.BinOp):
        return is_number(node.left) and is_number(node.right)
    if isinstance(node, ast.UnaryOp):
        return is_number(node.operand)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def named_numbers(path: Path) -> dict[str, ast.expr]:
    """Return the names that a file gives to numbers at its top level, each of a row `A, B = 1, 2` as well."""
    found = {}
    for node in tree_of(path).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            of_row = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
            pairs = zip(target.elts, node.value.elts, strict=True) if of_row else [(target, node.value)]
            found |= {ast.unparse(name): value for name, value in pairs if is_number(value)}
    return found


def inline_numbers(path: Path) -> Iterator[ast.Constant]:
    """Yield the numbers inside of expressions: not the named ones, not indices, not 0, 1 and 2."""
    named, rest = {id(value) for value in named_numbers(path).values()}, [tree_of(path)]
    while rest:
        node = rest.pop()
        if id(node) in named:
            continue
        if isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value not in PLAIN:
            yield node
        rest += [node.value] if isinstance(node, ast.Subscript) else ast.iter_child_nodes(node)
