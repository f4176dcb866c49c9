"""Pickling of records that contain CasADi expressions, which need a global pickle context."""

import pickle
from dataclasses import fields
from typing import Any

import casadi as ca


def packed(record: Any) -> bytes:
    """Return the values of a dataclass as bytes."""
    with ca.global_pickle_context():
        return pickle.dumps({field.name: getattr(record, field.name) for field in fields(record)})


def unpacked(kind: type, content: bytes) -> Any:
    """Return a record of the dataclass `kind` from the bytes of `packed`."""
    with ca.global_unpickle_context():
        return kind(**pickle.loads(content))
