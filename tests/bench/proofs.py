"""The part of `make bench` on proofs: a hundred plans next to their limit and a hundred spoilt between the samples."""

import time

from linkplan.planner.proof.prove import prove
from linkplan.studies.output.tables import table
from tests.bench.timing import say
from tests.support.provable import beside_its_limit, with_a_spoilt_coefficient

SEEDS = 100


def bench_proofs() -> str:
    """Return the table of the answers on the efforts of random four-bars by inverse dynamics."""
    rows = []
    for what, expected, case in (
        ("1e-9 below the mark", "proved", lambda seed: beside_its_limit(seed, -1e-9)),
        ("a coefficient moved, 1e-6 beyond the mark", "refuted", with_a_spoilt_coefficient),
    ):
        say(f"proofs: {what}")
        right, boxes, begin = 0, 0, time.process_time()
        for seed in range(SEEDS):
            proof = prove(*case(seed), existence=False)
            found = [finding for finding in proof.findings if "by inverse dynamics" in finding.name]
            right += {finding.answer for finding in found} == {expected}
            boxes += sum(finding.boxes for finding in found)
        rows.append([what, expected, right, SEEDS, boxes / SEEDS, (time.process_time() - begin) / SEEDS])
    return table(["plans", "expected", "right", "of", "boxes a plan", "proof and plan [s]"], rows)
