"""`make bench`: what plans cost and how exact they are, beside other people's programs; eight minutes in all.

Only ratios within one run mean anything on a shared machine; the medians beside them say what they are ratios of. Parts can
be named: `python -m tests.bench peer shares`, `make bench peer shares`; `rounding` and `many` run only where they are named.
Tables are printed, figures, CSV and JSON go to bench-results/, progress to stderr.
"""

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from tests.bench.c_code import bench_c
from tests.bench.ensemble import bench_ensemble
from tests.bench.explore import bench_explore
from tests.bench.many import bench_many
from tests.bench.mpc import bench_mpc
from tests.bench.packages import between_nodes
from tests.bench.peer import bench_peer, bench_plans
from tests.bench.precision import bench_precision
from tests.bench.proofs import bench_proofs
from tests.bench.rounding import bench_rounding
from tests.bench.shares import bench_shares
from tests.bench.sizes import bench_sizes

__all__ = ["PARTS", "between_nodes", "main"]

RESULTS = Path("bench-results")
PARTS: Mapping[str, Callable[[], str]] = {
    "peer": bench_peer,
    "shares": bench_shares,
    "plans": bench_plans,
    "sizes": lambda: bench_sizes(RESULTS),
    "ensemble": bench_ensemble,
    "explore": bench_explore,
    "c": bench_c,
    "mpc": bench_mpc,
    "proofs": bench_proofs,
    "precision": lambda: bench_precision(RESULTS),
}
# Parts that run only where they are named.
FURTHER: Mapping[str, Callable[[], str]] = {"rounding": bench_rounding, "many": lambda: bench_many(RESULTS)}


def main(names: list[str]) -> int:
    """Run the parts named, or all, and return the exit code."""
    every = {**PARTS, **FURTHER}
    unknown = [name for name in names if name not in every]
    if unknown:
        print(f"unknown part '{unknown[0]}'; parts are {', '.join(every)}", file=sys.stderr)
        return 2
    RESULTS.mkdir(exist_ok=True)
    for name in names or PARTS:
        text = every[name]()
        (RESULTS / f"{name}.txt").write_text(text + "\n", encoding="utf-8")
        print(text, end="\n\n", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
