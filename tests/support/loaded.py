"""Mechanisms of built-in names and of texts, each loaded once in a process: the knee takes 80 ms, in every sixth test.

What is kept with a mechanism (its functions, its reach) is worked out once, too. A model is then everybody's: a test that
changes one copies it first. Files are read every time.
"""

import functools
import hashlib
import pickle

from linkplan.models import mechanism as module
from linkplan.models.catalogue import MODELS, is_text
from linkplan.models.digest import compiled_bytes
from linkplan.models.mechanism import Mechanism

load = module.load_mechanism
# The mechanisms asked for since `changed_models` was asked last, and hashes of their models as loaded.
_GIVEN: dict[tuple[str, bytes], tuple[Mechanism, bytes]] = {}


def _model_hash(mechanism: Mechanism) -> bytes:
    return hashlib.sha256(compiled_bytes(mechanism.model)).digest()


@functools.lru_cache(maxsize=64)
def _loaded(source: str, asked: bytes) -> tuple[Mechanism, bytes]:
    mechanism = load(source, **pickle.loads(asked))
    return mechanism, _model_hash(mechanism)


@functools.wraps(load)
def load_once(source: object, **asked: object) -> Mechanism:
    if not isinstance(source, str) or not (source in MODELS or is_text(source)) or "file=" in source:
        return load(source, **asked)
    key = pickle.dumps(asked)
    _GIVEN[source, key] = found = _loaded(source, key)
    return found[0]


def share_mechanisms() -> None:
    """Let whoever imports `load_mechanism` by its name from here on load each mechanism once."""
    module.load_mechanism = load_once


def changed_models() -> list[str]:
    """Return the names of the mechanisms whose model was changed since it was loaded, and forget these mechanisms."""
    changed = [mechanism.name for mechanism, before in _GIVEN.values() if _model_hash(mechanism) != before]
    _GIVEN.clear()
    if changed:
        _loaded.cache_clear()
    return changed
