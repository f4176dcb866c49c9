"""What goes to another process: records with CasADi's expressions in them, which are pickled in a context of their own."""

import pickle
from dataclasses import fields
from typing import Any

import casadi as ca


def packed(record: Any) -> bytes:
    """Return a dataclass's values as bytes."""
    with ca.global_pickle_context():
        return pickle.dumps({field.name: getattr(record, field.name) for field in fields(record)})


def unpacked(kind: type, content: bytes) -> Any:
    """Return a record of a kind from its bytes."""
    with ca.global_unpickle_context():
        return kind(**pickle.loads(content))
