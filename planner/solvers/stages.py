"""A program's unknowns and rows in stages, as solvers want them whose linear algebra follows the motion.

Such a solver wants stage k's unknowns y_k = [states x_k; controls u_k], its rows [x_{k+1} - F(x_k, u_k) = 0; the other rows
of y_k], and nothing that ties a stage to others than the next. An interval is a stage: its left state is the states, all
else that is its own the controls. What spans more (durations, a factor on all limits, the first state of a motion that
returns, an effort that goes on without a jump) begins as a state or control where it first occurs and is carried on as a
state, copied unchanged, for as far as rows ask for it. So every program of `planner.transcription.program` has stages.
"""

from dataclasses import dataclass

import numpy as np

from linkplan.planner.transcription.program import Program
from linkplan.planner.transcription.system import Endpoint
from linkplan.planner.transcription.triplets import Triplets


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class Stages:
    """Where a program's unknowns x stand among the stages' y.

    `source` (n_y,) is the unknown that each y is, or is a copy of, `stage` (n_y,) its stage; `home` (n_x,) the y that is
    each unknown itself; `copies` the y of (unknown, stage); `carried` the unknowns copied into each stage. `n_states` and
    `n_controls` (n_stages,) count. `linear` (n_linear,) is the stage of each linear row.
    """

    source: np.ndarray
    stage: np.ndarray
    home: np.ndarray
    copies: dict[tuple[int, int], int]
    carried: tuple[tuple[int, ...], ...]
    n_states: tuple[int, ...]
    n_controls: tuple[int, ...]
    linear: np.ndarray

    def at(self, unknown: int, stage: int) -> int:
        """Return the y that holds an unknown in a stage."""
        return self.copies.get((int(unknown), int(stage)), int(self.home[unknown]))

    def carried_rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs (n_copies, 2) of y that are equal, the copy first, and the stage (n_copies,) of each pair's row."""
        pairs, stages = [], []
        for k, unknowns in enumerate(self.carried):
            for unknown in unknowns:
                pairs.append((self.at(unknown, k), self.at(unknown, k - 1)))
                stages.append(k - 1)
        return np.array(pairs, dtype=int).reshape(-1, 2), np.array(stages, dtype=int)


def stages_of(program: Program, endpoint: Endpoint | None) -> Stages:
    """Return the stages of a program: one for each interval, and the last state's."""
    layout, mesh, n = program.layout, program.mesh, program.layout.n_intervals
    begins = np.zeros(layout.size, dtype=int)
    begins[: n * layout.block] = np.arange(n * layout.block) // layout.block
    begins[layout.state(n)] = n
    begins[layout.durations()] = np.searchsorted(mesh.segment, np.arange(mesh.n_segments))
    last = begins.copy()
    last[layout.durations()] = np.searchsorted(mesh.segment, np.arange(mesh.n_segments), side="right") - 1
    linear = _stages_of_rows(program.linear, begins, last)
    if endpoint is not None:
        for argument, unknowns in ((0, layout.state(0)), (2, layout.durations())):
            if endpoint.function.jac_sparsity(0, argument).nnz():
                last[unknowns] = n
        if endpoint.algebraic:
            last[layout.dependent()[-1, -1]] = n
    carried: list[list[int]] = [[] for _ in range(n + 1)]
    for unknown in np.flatnonzero(last > begins):
        for k in range(begins[unknown] + 1, last[unknown] + 1):
            carried[k].append(int(unknown))
    source, n_states, n_controls = [], [], []
    further = np.concatenate([layout.durations(), layout.extra()])
    for k in range(n + 1):
        states = [*layout.state(k).tolist(), *carried[k]]
        inner = np.arange(k * layout.block + layout.n_state, (k + 1) * layout.block if k < n else 0)
        controls = [*inner.tolist(), *further[begins[further] == k].tolist()]
        n_states.append(len(states))
        n_controls.append(len(controls))
        source += states + controls
    stage = np.repeat(np.arange(n + 1), np.array(n_states) + np.array(n_controls))
    unknown = np.array(source)
    original = begins[unknown] == stage
    home = np.zeros(layout.size, dtype=int)
    home[unknown[original]] = np.flatnonzero(original)
    return Stages(
        source=unknown,
        stage=stage,
        home=home,
        copies={(int(unknown[y]), int(stage[y])): int(y) for y in np.flatnonzero(~original)},
        carried=tuple(tuple(unknowns) for unknowns in carried),
        n_states=tuple(n_states),
        n_controls=tuple(n_controls),
        linear=linear,
    )


def _stages_of_rows(linear: Triplets, begins: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return each row's stage, that of its latest unknown; unknowns that it needs there then last until there."""
    stages = np.zeros(linear.shape[0], dtype=int)
    for row in range(linear.shape[0]):
        columns = linear.columns[linear.rows == row]
        stages[row] = begins[columns].max()
        np.maximum.at(last, columns, stages[row])
    return stages
