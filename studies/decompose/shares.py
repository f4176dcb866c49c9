"""A tracking error split among its causes: signed parts that add up to its rms.

With e_0 = 0 and e_1 to e_K the errors on the rungs of a ladder, e_K = e the whole one, and <a, b> the mean over control
instants and machines of the sum over joints of a b, the part of rung k is the increment's projection on the whole error,

    p_k = <e_k - e_{k-1}, e> / rms,   rms = sqrt(<e, e>),   so that p_1 + ... + p_K = rms

exactly. A negative part takes error away. Increments' own rms values, or differences of the rungs' rms, do not add up to
anything one sees: errors of different causes oppose one another, or come at other times.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Shares:
    """What a rms error is made of, in its unit.

    `parts` (K,) add up to `rms`, and so do `of_joints` (K, n_s) over both axes; `alone` (K,) are the increments' own rms
    values, `after` (K,) the rms of the error on each rung.
    """

    rms: float
    parts: np.ndarray
    of_joints: np.ndarray
    alone: np.ndarray
    after: np.ndarray


def shares_of(errors: np.ndarray) -> Shares:
    """Return the parts of the errors e_1 to e_K (K, t, n, n_s) of t instants, n machines and n_s joints of one unit."""
    increments = np.diff(errors, axis=0, prepend=0.0)
    instants = errors.shape[1] * errors.shape[2]

    def rms_of(values: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(values**2, axis=(1, 2, 3)) / instants)

    rms = float(rms_of(errors[-1:])[0])
    projected = np.sum(increments * errors[-1], axis=(1, 2)) / instants
    of_joints = projected / rms if rms > 0 else np.zeros_like(projected)
    return Shares(rms=rms, parts=of_joints.sum(axis=1), of_joints=of_joints, alone=rms_of(increments), after=rms_of(errors))
