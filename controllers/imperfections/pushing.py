"""Pushes on many simulations at once: forces on bodies and efforts on joints during time windows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkplan.controllers.imperfections.imperfections import Imperfections, Push
from linkplan.controllers.imperfections.plant import Plant, body_index
from linkplan.models.errors import LinkplanError
from linkplan.models.mechanism import Mechanism


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Pushing:
    """Pushes (n, m) on simulations, from `start` to `end` [simulator steps of each simulation]; m is the largest number.

    `force` (n, m, nbody, 6) [N, N.m] acts at the bodies' centres of mass, `effort` (n, m, nv) [N.m or N] on joints.
    """

    start: np.ndarray
    end: np.ndarray
    force: np.ndarray
    effort: np.ndarray

    def kept(self, rows: np.ndarray) -> "Pushing":
        """Return the pushes on some of these simulations, by a mask (n,)."""
        return replace(self, **{name: getattr(self, name)[rows] for name in ("start", "end", "force", "effort")})

    def over(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean forces (n, nbody, 6) and efforts (n, nv) over a simulator step."""
        share = np.maximum(np.minimum(step + 1.0, self.end) - np.maximum(float(step), self.start), 0.0)
        force, effort = np.zeros(self.force[:, 0].shape), np.zeros(self.effort[:, 0].shape)
        for i in range(share.shape[1]):  # a fixed order of summation keeps the last bit reproducible
            force += share[:, i, None, None] * self.force[:, i]
            effort += share[:, i, None] * self.effort[:, i]
        return force, effort


def pushing(
    machines: Sequence[Imperfections], plants: Sequence[Plant], mechanism: Mechanism, substeps: int
) -> Pushing | None:
    """Return the pushes on machines, or None if no machine has one.

    Raises:
        LinkplanError: for an unknown body or joint.
    """
    n, most, model = len(machines), max((len(one.pushes) for one in machines), default=0), mechanism.model
    if most == 0:
        return None
    start, end = np.zeros((n, most)), np.zeros((n, most))
    force, effort = np.zeros((n, most, model.nbody, 6)), np.zeros((n, most, model.nv))
    for i, (one, built) in enumerate(zip(machines, plants, strict=True)):
        h, begun = float(built.model.opt.timestep), one.clock.phase_periods * substeps
        for m, push in enumerate(one.pushes):
            start[i, m] = push.start_s / h - begun
            end[i, m] = start[i, m] + push.duration_s / h
            _place(push, mechanism, force[i, m], effort[i, m])
    return Pushing(start=start, end=end, force=force, effort=effort)


def _place(push: Push, mechanism: Mechanism, force: np.ndarray, effort: np.ndarray) -> None:
    if push.body is not None and push.force is not None:
        force[body_index(mechanism.model, push.body), :3] = push.force
    if push.joint is not None:
        effort[mechanism.joint_index(push.joint, LinkplanError)] = push.effort
