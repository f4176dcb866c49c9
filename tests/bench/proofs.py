"""The part of `make bench` on proofs: correct plans next to their limits, and plans spoilt between the samples.

`python -m tests.bench proofs` takes some ten minutes. It places every kind of limit beside what random motions of many
mechanisms need, and the effort limits of a hundred random four-bars. Wrong answers are printed to stderr with their reasons.
"""

import time
from collections.abc import Callable, Mapping

import numpy as np

from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.proof.prove import prove
from linkplan.studies.output.text import table
from tests.bench.timing import say
from tests.support.digger import DIGGER
from tests.support.four_bars import load
from tests.support.linkages import loaded
from tests.support.mechanisms import CHAINS, doubled_pin, random_four_bar, random_quaternion, random_tree
from tests.support.open_linkages import random_linkage
from tests.support.parallel_ankle import ankle_text
from tests.support.provable import beside_its_limit, with_a_spoilt_coefficient
from tests.support.sliders import random_slider
from tests.support.spoilt import answers_beside_limits

SEEDS, SEEDS_OF_EACH = 100, 4


def _text(of: Callable[[np.random.Generator], str]) -> Callable[[np.random.Generator], Mechanism]:
    return lambda rng: load_mechanism(of(rng))


# Mechanisms by name: sliders with springs, spatial loops, two motors, a servo, couplings, welds, push rods on ball joints,
# a pin held twice, payloads, open trees, sites.
FAMILIES: Mapping[str, Callable[[np.random.Generator], Mechanism]] = {
    "four-bar": lambda rng: load(random_four_bar(rng), int(rng.integers(99))),
    "pin held twice": _text(lambda rng: doubled_pin(random_four_bar(rng), random_quaternion(rng))),
    "slider with a spring": _text(lambda rng: random_slider(rng).mjcf(float(rng.uniform(-3, 3)), 100.0)),
    **{kind: _text(lambda rng, kind=kind: random_linkage(rng, kind).mjcf) for kind in ("watt", "stephenson", "rssr")},
    **{name: lambda _, name=name: loaded(name) for name in ("welded", "gripper", "press", "leg", "rscr")},
    **{name: _text(lambda _, name=name: CHAINS[name]) for name in ("five-bar", "spatial-loop")},
    "parallel ankle": _text(lambda _: ankle_text()),
    "digger": _text(lambda _: DIGGER),
    "open tree": _text(lambda rng: random_tree(int(rng.integers(50)))),
    "knee with a shank": lambda _: load_mechanism("optimus-knee", payload="shank"),
    "knee, linear": lambda _: load_mechanism("optimus-knee-linear"),
    "cart-pole": lambda _: load_mechanism("cart-pole"),
}


def bench_proofs() -> str:
    """Return the tables of the answers beside limits of all kinds, and on the efforts of random four-bars."""
    return f"{_of_all_kinds()}\n\n{_of_four_bars()}"


def _of_all_kinds() -> str:
    rows = []
    for name, build in FAMILIES.items():
        say(f"proofs: {name}")
        begin, found = time.process_time(), []
        for seed in range(SEEDS_OF_EACH):
            rng = np.random.default_rng([seed, *name.encode()])
            found += answers_beside_limits(build(rng), rng)
        for answer in found:
            if not answer.right:
                say(f"  wrong: {answer.words}, {answer.case} its limit, is {answer.answers}: {answer.reason}")
        counts = [sum(a.right for a in found if a.expected == word) for word in ("proved", "refuted")]
        rows.append([name, *counts, len(found), (time.process_time() - begin) / SEEDS_OF_EACH])
    return table(["mechanism", "1e-9 below: proved", "1e-6 beyond: refuted", "limits", "a seed [s]"], rows)


def _of_four_bars() -> str:
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
