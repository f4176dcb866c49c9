"""Mutants: small changes of models, planner and controllers, and whether the nearest tests detect them.

    python -m tests.bench.mutants [--count 60] [--seed 1] [--kind all|inline|other] [--under DIR] [--timeout 600]

Each mutant changes one named or inline number, sign, comparison or bound in a copy of the tree. The nearest tests are the
files of the same name, the files that import the changed one, and the folder of the same name; the slow ones among them run
last. They run until the first failure, which counts if that test passes without the change. The script prints every mutant
with "detected", "timed out" or "SURVIVED", and the share that did not survive.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.sources import inline_numbers

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("models", "planner", "controllers")
COPIED = ("linkplan", "models", "planner", "controllers", "studies", "tests", "pyproject.toml", "docs", "README.md")
# What stands for what in a mutant.
COMPARISONS = {ast.Lt: ">", ast.LtE: ">", ast.Gt: "<", ast.GtE: "<"}
OPERATORS = {ast.Add: "-", ast.Sub: "+"}
BOUNDS = {"maximum": "minimum", "minimum": "maximum", "max": "min", "min": "max", "fmax": "fmin", "fmin": "fmax"}
NUMBER_FACTOR = 10.0
# Pytest's exit codes where it does not know a test, and where it has selected none.
UNKNOWN_TEST, NO_TESTS = 4, 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """A replacement of the characters from `begin` to `end` of one line."""

    path: Path
    line: int
    begin: int
    end: int
    text: str
    inline: bool = False

    def applied_to(self, source: str) -> str:
        """Return the source with the change."""
        lines = source.splitlines(keepends=True)
        old = lines[self.line - 1].encode()
        lines[self.line - 1] = (old[: self.begin] + self.text.encode() + old[self.end :]).decode()
        return "".join(lines)

    def words(self) -> str:
        """Return the place, and the line before and after the change."""
        source = (ROOT / self.path).read_text(encoding="utf-8")
        before, after = (text.splitlines()[self.line - 1].strip() for text in (source, self.applied_to(source)))
        return f"{self.path}:{self.line}\n    - {before}\n    + {after}"


def number_mutant(path: Path, number: ast.Constant, *, inline: bool = False) -> Mutant:
    """Return the mutant that multiplies a number by ten."""
    text = repr(type(number.value)(number.value * NUMBER_FACTOR))
    begin, end = number.col_offset, number.end_col_offset or 0
    return Mutant(path=path, line=number.lineno, begin=begin, end=end, text=text, inline=inline)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield the mutants of a file."""
    source = (ROOT / path).read_text(encoding="utf-8")
    lines = [line.encode() for line in source.splitlines()]
    for number in inline_numbers(ROOT / path):
        yield number_mutant(path, number, inline=True)
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Assign) and node.col_offset == 0:
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            numbers = [value for value in values if isinstance(value, ast.Constant) and type(value.value) in (int, float)]
            yield from (number_mutant(path, number) for number in numbers if number.value)
        elif isinstance(node, ast.Compare | ast.BinOp):
            left, right = (node.left, node.comparators[0]) if isinstance(node, ast.Compare) else (node.left, node.right)
            table = COMPARISONS if isinstance(node, ast.Compare) else OPERATORS
            operator = table.get(type(node.ops[0] if isinstance(node, ast.Compare) else node.op))
            if operator is None or left.end_lineno != right.lineno or (left.end_col_offset or 0) >= right.col_offset:
                continue
            begin, end = left.end_col_offset or 0, right.col_offset
            between = lines[right.lineno - 1][begin:end].decode()
            if between.strip().replace("=", "") not in ("<", ">", "+", "-"):
                continue
            yield Mutant(path=path, line=right.lineno, begin=begin, end=end, text=f" {operator} ")
        elif isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in BOUNDS and node.func.end_col_offset is not None:
                end = node.func.end_col_offset
                yield Mutant(path=path, line=node.func.end_lineno or 0, begin=end - len(name), end=end, text=BOUNDS[name])


def nearest_tests(path: Path) -> list[str]:
    """Return the tests nearest to a file: those of its name, those that import it (its folder's first), its folder."""
    folder = Path("tests") / path.parent
    folder = folder if (ROOT / folder).is_dir() else folder.parent
    module = "linkplan." + ".".join(path.with_suffix("").parts)
    every = sorted((ROOT / "tests").rglob("test_*.py"), key=lambda test: (ROOT / folder not in test.parents, test))
    named = [test for test in every if test.name == f"test_{path.name}"]
    files = [*named, *(test for test in every if module in test.read_text(encoding="utf-8"))]
    return [*dict.fromkeys(str(test.relative_to(ROOT)) for test in files), str(folder)]


def verdict_on(mutant: Mutant, copy: Path, *, timeout_s: float) -> str:
    """Return "detected" if the nearest tests fail with the change only, else "SURVIVED"; the copy is as before afterwards.

    "timed out" means that they take longer than `timeout_s`: an endless loop, if they take less without the change.
    """
    target = copy / mutant.path

    def failed(tests: list[str], mark: str) -> list[str]:
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", mark, *tests]
        environment = {**os.environ, "PYTHONPATH": str(copy)}  # commands that tests start import the copy, too
        run = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=timeout_s, check=False
        )
        whole = [re.sub(r"\[.*", "", test) for test in tests]
        if run.returncode == UNKNOWN_TEST and whole != tests:  # parameters that are numbers of the changed file
            return failed(whole, mark)
        words = re.findall(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", run.stdout, flags=re.MULTILINE)
        return words or tests if run.returncode not in (0, NO_TESTS) else []

    source = target.read_text(encoding="utf-8")
    target.write_text(mutant.applied_to(source), encoding="utf-8")
    nearest = nearest_tests(mutant.path)
    try:
        first = failed(nearest, "not slow") or failed(nearest, "slow")
    except subprocess.TimeoutExpired:
        return "timed out"
    finally:
        target.write_text(source, encoding="utf-8")
    return "detected" if first and not failed(first, "") else "SURVIVED"


def main() -> int:
    """Draw mutants, run the nearest tests on each, and print the share detected."""
    parser = argparse.ArgumentParser(description="Changes of the code, and whether the nearest tests see them.")
    parser.add_argument("--count", type=int, default=60, help="number of mutants")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--kind", choices=("all", "inline", "other"), default="all", help="inline numbers alone, or all else"
    )
    parser.add_argument("--under", nargs="*", default=PACKAGES, help="folders whose files are changed (all)")
    parser.add_argument("--timeout", type=float, default=600.0, help="longest run of the tests of one mutant [s]")
    arguments = parser.parse_args()
    files = [path.relative_to(ROOT) for package in arguments.under for path in sorted((ROOT / package).rglob("*.py"))]
    every = [mutant for path in files for mutant in mutants_of(path)]
    if arguments.kind != "all":
        every = [mutant for mutant in every if mutant.inline == (arguments.kind == "inline")]
    drawn = random.Random(arguments.seed).sample(every, min(arguments.count, len(every)))
    detected = 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, copy / name, symlinks=True)
            else:
                shutil.copy(source, copy / name)
        for number, mutant in enumerate(drawn, 1):
            verdict = verdict_on(mutant, copy, timeout_s=arguments.timeout)
            detected += verdict != "SURVIVED"
            print(f"{number}/{len(drawn)} {verdict}: {mutant.words()}", flush=True)
    print(f"{detected} of {len(drawn)} detected ({detected / len(drawn):.0%}), out of {len(every)} possible mutants")
    return 0


if __name__ == "__main__":
    sys.exit(main())
