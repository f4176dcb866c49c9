"""The distribution of a generalised effort among actuators, within their limits.

    u = argmin |u - u_0|^2   subject to   B u = tau,   low <= u <= high

B (n_s, n_u) stands for Gamma^T B. With more actuators than freedoms, many efforts u produce one tau. Among those within the
limits the nearest to u_0 is taken: u_0 is 0, a pre-tension, or the efforts of a plan. If no efforts within the limits
produce tau, the efforts are those that violate the limits least, in units of each actuator's limit: they minimise the sum of
((u - clip(u)) / size)^2. Without redundancy only one u produces tau, whatever the limits.

DAQP solves the quadratic programs (Arnstrom, Bemporad & Axehill, IEEE Trans. Automatic Control 67, 2022), in coordinates z
of the null space of B: u = u_p + N z.
"""

import numpy as np

# Moment arms below this share of the largest are zero to rounding, at an actuator's dead centre.
ZERO_ARM_SHARE = 1e-12
# Efforts that miss at most this share of the largest effort count as complete: above rounding, and negligible in practice.
HOLDING_TOLERANCE = 1e-9
UNLIMITED = np.array([-np.inf, np.inf])
LEAST_SQUARES, LEAST_PEAK = "least_squares", "least_peak"
# The weight of |z|^2 beside a violation or a peak, in units of the limits: it decides only between equal ones.
_TIE_WEIGHT = 1e-8
# Bounds are satisfied to this share of an actuator's limit: below `HOLDING_TOLERANCE`, which rounds onto them.
_BOUND_TOLERANCE = 1e-10
# Efforts this near to a limit, as a share of it, are at the limit.
_ROUNDING_SHARE = 1e-13


def distribute(
    tau: np.ndarray, maps: np.ndarray, limit: np.ndarray, wanted: np.ndarray | float = 0.0, rule: str = LEAST_SQUARES
) -> np.ndarray:
    """Return the efforts (n, n_u) that produce generalised efforts tau (n, n_s), or the nearest where none produce them.

    Args:
        tau: generalised efforts [N.m or N].
        maps: Gamma^T B (n, n_s, n_u).
        limit: of the actuators (n_u, 2), or of each sample (n, n_u, 2) [N.m or N].
        wanted: u_0, one for all, (n_u,) or (n, n_u) [N.m or N].
        rule: "least_squares", or "least_peak": the largest share of a limit, |u - u_0| / size, is least.
    """
    n, n_u = len(tau), maps.shape[2]
    wanted = np.broadcast_to(np.asarray(wanted, dtype=float), (n, n_u))
    effort = wanted + np.einsum("kus,ks->ku", unit_efforts(maps), tau - np.einsum("ksu,ku->ks", maps, wanted))
    limit = np.broadcast_to(limit, (n, n_u, 2))
    low, high = limit[..., 0], limit[..., 1]
    asked = np.full(n, True) if rule == LEAST_PEAK else np.any((effort < low) | (effort > high), axis=1)
    left = np.flatnonzero(asked & np.isfinite(effort).all(axis=1) & np.isfinite(maps).all(axis=(1, 2))) if n_u > 1 else ()
    if not len(left):
        return effort
    size = actuator_sizes(limit[left])
    null, free = _null_spaces(maps[left])
    null = null * (size.max(axis=1, keepdims=True) / size)[:, :, None]  # z in units of the largest limit
    ends = tuple((limit[left, :, end] - effort[left]) / size for end in (0, 1))
    about = (effort[left] - wanted[left]) / size
    moved = _moved(null, free, ends, about if rule == LEAST_PEAK else None)
    found = effort[left] + size * moved
    inside = np.clip(found, low[left], high[left])
    found = np.where(np.abs(found - inside) <= HOLDING_TOLERANCE * size, inside, found)
    for end in (low[left], high[left]):  # at a limit exactly
        found = np.where(np.abs(found - end) <= _ROUNDING_SHARE * size, end, found)
    effort[left] = found
    return effort


def unit_efforts(maps: np.ndarray) -> np.ndarray:
    """Return the efforts (..., n_u, n_s) of least norm that produce a unit on each coordinate, by maps (..., n_s, n_u).

    They are the pseudo-inverses of the maps. If all maps are equal, as for motors on coordinates, only one is computed.
    """
    same = maps.ndim == 3 and len(maps) > 1 and bool(np.all(maps == maps[0]))
    found = np.linalg.pinv(maps[:1] if same else maps, rcond=ZERO_ARM_SHARE)
    return np.broadcast_to(found, (*maps.shape[:-2], *found.shape[-2:]))


def missed_rounding(limit: np.ndarray) -> float:
    """Return the error of efforts that counts as rounding [N.m or N], for actuators with limits (..., n_u, 2)."""
    return HOLDING_TOLERANCE * np.where(np.isfinite(limit), np.abs(limit), 0.0).max(initial=1.0)


def lacking(tau: np.ndarray, maps: np.ndarray, effort: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return what efforts (n, n_u), cut to limits (n_u, 2), lack of generalised efforts tau (n, n_s); rounding is 0."""
    missed = tau - np.einsum("ksu,ku->ks", maps, np.clip(effort, *limit.T))
    return np.where(np.abs(missed) > missed_rounding(limit), missed, 0.0)


def actuator_sizes(limit: np.ndarray) -> np.ndarray:
    """Return the larger absolute limit (..., n_u) of actuators (..., n_u, 2), the unit of an effort; 1 without limits."""
    size = np.where(np.isfinite(limit), np.abs(limit), 0.0).max(axis=-1)
    return np.where(size > 0, size, 1.0)


def _null_spaces(maps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return orthonormal columns (n, n_u, n_u), the last of which span the null spaces, and the number (n,) of these."""
    same = bool(np.all(maps == maps[0]))
    _, sizes, rows = np.linalg.svd(maps[:1] if same else maps)
    rank = np.sum(sizes > ZERO_ARM_SHARE * sizes.max(axis=1, initial=0.0, keepdims=True), axis=1)
    shape = (len(maps), *rows.shape[1:])
    return np.broadcast_to(rows.transpose(0, 2, 1), shape), np.broadcast_to(maps.shape[2] - rank, len(maps))


def _moved(null: np.ndarray, free: np.ndarray, ends: tuple[np.ndarray, ...], about: np.ndarray | None) -> np.ndarray:
    """Return N z (n, n_u) within bounds, or the ones that violate them least; N are the last `free` columns of `null`.

    They have the least |z|, or the least peak of `about` + N z. The active bounds of one sample are tried on all others.
    """
    (low, high), found = ends, np.zeros_like(ends[0])
    left = np.flatnonzero(free)
    while left.size:
        k = left[0]
        N = null[left, :, null.shape[2] - free[k] :]
        found[k], active = _solved(N[0], low[k], high[k], None if about is None else about[k])
        done = np.arange(left.size) == 0
        if active is not None:
            at = np.flatnonzero(active)
            bound = np.where(active[at] > 0, high[left][:, at], low[left][:, at])
            z = np.einsum("kzj,kj->kz", unit_efforts(N[:, at]), bound)
            pull = -active[at] * np.einsum("kjz,kz->kj", unit_efforts(N[:, at].transpose(0, 2, 1)), z)
            u = np.einsum("kuz,kz->ku", N, z)
            inside = (u >= low[left] - _BOUND_TOLERANCE) & (u <= high[left] + _BOUND_TOLERANCE)
            right = inside.all(axis=1) & np.all(pull >= -_BOUND_TOLERANCE, axis=1) & (free[left] == free[k])
            found[left[right]] = u[right]
            done |= right
        left = left[~done]
    return found


def _solved(
    N: np.ndarray, low: np.ndarray, high: np.ndarray, about: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return N z (n_u,) of one sample as `_moved`, and the signs (n_u,) of its active bounds where they determine it."""
    import daqp

    n_u, n_z = N.shape
    z, _, flag, info = daqp.solve(np.eye(n_z), np.zeros(n_z), N, high, low, primal_tol=_BOUND_TOLERANCE)
    if flag <= 0:  # no efforts within the limits: the least violation e of the bounds, low - e <= N z <= high + e
        rows, weights = np.hstack([N, -np.eye(n_u)]), np.append(np.full(n_z, _TIE_WEIGHT), np.ones(n_u))
        z = daqp.solve(np.diag(weights), np.zeros(n_z + n_u), rows, high, low, primal_tol=_BOUND_TOLERANCE)[0][:n_z]
        return N @ z, None
    if about is None:
        return N @ z, np.sign(np.where(np.abs(info["lam"]) > 0, info["lam"], 0.0))
    one, none = np.ones((n_u, 1)), np.full(n_u, np.inf)  # t is the peak: -t <= about + N z <= t
    rows = np.vstack([np.hstack([N, 0 * one]), np.hstack([N, one]), np.hstack([N, -one])])
    weights, slope = np.full(n_z + 1, _TIE_WEIGHT), np.append(np.zeros(n_z), 1.0)
    above, below = np.concatenate([high, none, -about]), np.concatenate([low, -about, -none])
    return N @ daqp.solve(np.diag(weights), slope, rows, above, below, primal_tol=_BOUND_TOLERANCE)[0][:n_z], None
