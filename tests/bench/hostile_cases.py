"""The cases of `python -m tests.bench.hostile`: files, places, saved results and command lines that no mutation makes."""

from tests.bench.hostile_features import FEATURES
from tests.bench.hostile_files import FILES
from tests.bench.hostile_numbers import EDGES
from tests.bench.hostile_places import PLACES
from tests.bench.hostile_plans import PLANS
from tests.bench.hostile_processes import PROCESSES
from tests.bench.hostile_results import RESULTS_CASES
from tests.bench.hostile_words import WORDS

CASES = (*FILES, *FEATURES, *EDGES, *PLACES, *PROCESSES, *PLANS, *RESULTS_CASES, *WORDS)
