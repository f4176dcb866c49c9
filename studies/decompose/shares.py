"""A tracking error as a sum of its causes: signed parts that add up to the rms error.

Let e_1 to e_K be the errors after causes 1 to K are switched on, and e = e_K the total error. Let d_k be what cause k
adds, so that d_1 + ... + d_K = e: e_k - e_{k-1}, or its mean over several orders of the causes. Let <a, b> be the mean over
control instants and machines of the sum over joints of a b. The part of cause k is the projection of its increment on the
total error:

    p_k = <d_k, e> / rms,   rms = sqrt(<e, e>),   so that p_1 + ... + p_K = rms

exactly. A negative part reduces the error. The rms values of the increments, and the differences of rms values, do not add
up to the rms error, because errors of different causes can cancel or occur at different times.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Shares:
    """The parts of a rms error, in its unit.

    `parts` (K,) add up to `rms`, and so do `of_joints` (K, n_s) over both axes. `alone` (K,) are the rms values of the
    increments; `after` (K,) is the rms error after each cause is switched on.
    """

    rms: float
    parts: np.ndarray
    of_joints: np.ndarray
    alone: np.ndarray
    after: np.ndarray


def shares_of(errors: np.ndarray, increments: np.ndarray) -> Shares:
    """Return the parts of errors e_K from e_1 to e_K and d_1 to d_K (K, t, n, n_s).

    t instants, n machines, n_s joints of one unit.
    """
    instants = errors.shape[1] * errors.shape[2]

    def rms_of(values: np.ndarray) -> np.ndarray:
        return np.sqrt(np.sum(values**2, axis=(1, 2, 3)) / instants)

    rms = float(rms_of(errors[-1:])[0])
    projected = np.sum(increments * errors[-1], axis=(1, 2)) / instants
    of_joints = projected / rms if rms > 0 else np.zeros_like(projected)
    return Shares(rms=rms, parts=of_joints.sum(axis=1), of_joints=of_joints, alone=rms_of(increments), after=rms_of(errors))
