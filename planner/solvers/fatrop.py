"""Solving a program with FATROP: the same program, unknown for unknown, ordered in stages; its answer is checked again."""

import contextlib
import io
import time
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from linkplan.models.errors import ProblemError
from linkplan.models.interrupts import asked
from linkplan.planner.solvers.outcome import INVALID, OUT_OF_ITERATIONS, OUT_OF_TIME, SUCCEEDED, TOLERANCE
from linkplan.planner.solvers.stages import Stages, stages_of
from linkplan.planner.transcription.layout import Layout
from linkplan.planner.transcription.mesh import Mesh
from linkplan.planner.transcription.program import Program, build_program
from linkplan.planner.transcription.system import Endpoint
from linkplan.planner.transcription.triplets import Triplets, no_rows, pattern, scatter

# FATROP relaxes every bound by this share of its size, and of one where that is larger; no option of its own stops it.
_RELAXED = 1e-8
# An answer's rows, in scaled units, are kept to this or it is none. The solver is asked for 1e-10 of them.
_KEPT = 1e-7
# Beyond this a number counts as not finite; what an objective or row is in place of one that is not.
_LARGEST, _FAR = 1e100, 1e20


class FatropSolver:
    """FATROP for one program: called with the program's own numbers as `casadi.nlpsol` is, answering in its unknowns.

    Raises (when built):
        ProblemError: for a program that has no stages.
    """

    def __init__(
        self, program: Program, endpoint: Endpoint | None, *, max_iterations: int, max_time_s: float, warm: bool
    ) -> None:
        self._stages, self._clock = stages_of(program, endpoint), _Clock(max_time_s)
        functions, self._row_order, n_rows = _staged(program, self._stages, endpoint, self._clock)
        self._functions, self._max_iterations = program.functions, max_iterations
        self._said: dict[str, Any] = {}
        options = {
            "tolerance": TOLERANCE,
            "constr_viol_tol": TOLERANCE,
            # An "acceptable" stop is not accepted as an answer.
            "tol_acceptable": TOLERANCE,
            "max_iter": max_iterations,
            "print_level": 0,
            "tiny_step_tol": 0.0,
        }
        if warm:
            options |= {"mu_init": 1e-4, "bound_push": 1e-6, "bound_frac": 1e-6}
        self._solver = ca.nlpsol(
            "solver",
            "fatrop",
            functions.pop("nlp"),
            {
                "print_time": False,
                "show_eval_warnings": False,
                # FATROP's interface has no options for derivatives: CasADi looks into this cache before it makes them.
                "cache": functions,
                "calc_lam_p": False,
                "structure_detection": "manual",
                "N": program.layout.n_intervals,
                "nx": list(self._stages.n_states),
                "nu": list(self._stages.n_controls),
                "ng": n_rows,
                "fatrop": options,
            },
        )

    def __call__(self, **numbers: Any) -> dict[str, Any]:
        """Return the answer, "x" and "f", from x0, p, lbx, ubx, lbg and ubg."""
        x0, p, lower, upper, g_lower, g_upper = (np.asarray(numbers[k]) for k in ("x0", "p", "lbx", "ubx", "lbg", "ubg"))
        source, home, order = self._stages.source, self._stages.home, self._row_order
        original = np.zeros(len(source), dtype=bool)
        original[home] = True
        equal = np.zeros(len(order) - len(g_lower))  # a copy less what it copies
        low, high = _narrowed(lower, upper)
        g_low, g_high = _narrowed(g_lower, g_upper)
        x, f, g = self._checked(x0, p, lower, upper)
        if not (np.isfinite(f) and np.all(np.isfinite(g))):  # FATROP does not recover from there
            return self._answer(x, f, INVALID, {"iter_count": 0})
        self._clock.start()
        try:
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                result = self._solver(
                    x0=x[source],
                    p=p,
                    lbx=np.where(original, low[source], -np.inf),
                    ubx=np.where(original, high[source], np.inf),
                    lbg=np.concatenate([g_low, equal])[order],
                    ubg=np.concatenate([g_high, equal])[order],
                )
        except RuntimeError:
            if not self._clock.stopped:
                raise
            return self._answer(x, f, OUT_OF_TIME, {"iter_count": 0})
        x, f, g = self._checked(np.array(result["x"]).ravel()[home], p, lower, upper)
        slopes = [np.array(self._functions[name](x, p)[1].nz[:]) for name in ("grad_f", "jac_g")]
        said = self._solver.stats()
        if self._clock.stopped:
            status = OUT_OF_TIME
        elif not all(np.all(np.isfinite(value)) for value in (f, g, *slopes)):
            status = INVALID
        elif not said["success"]:
            status = OUT_OF_ITERATIONS if said["iter_count"] >= self._max_iterations else "Search_Direction_Not_Found"
        else:
            kept = np.all(g >= g_lower - _KEPT) and np.all(g <= g_upper + _KEPT)
            status = SUCCEEDED if kept else "Rows_Not_Kept"
        return self._answer(x, f, status, said)

    def _checked(self, x, p, lower, upper) -> tuple[np.ndarray, float, np.ndarray]:
        """Return unknowns within their bounds, their objective and their rows."""
        x = np.clip(x, lower, upper)
        f, g = self._functions["nlp"](x, p)
        return x, float(f), np.array(g).ravel()

    def _answer(self, x: np.ndarray, f: float, status: str, said: dict[str, Any]) -> dict[str, Any]:
        self._said = said | {"success": status == SUCCEEDED, "return_status": status}
        return {"x": x, "f": f}

    def stats(self) -> dict[str, Any]:
        """Return what there is to say of the last answer."""
        return self._said


class _Clock(ca.Callback):
    """Zero while there is time and no signal asks for an end. Afterwards nothing is evaluated any more.

    FATROP has no limit on time of its own.
    """

    def __init__(self, max_time_s: float) -> None:
        ca.Callback.__init__(self)
        self._max_time_s, self._end = max_time_s, np.inf
        self.stopped = False
        self.construct("clock", {})

    def start(self) -> None:
        """Begin to count."""
        self._end, self.stopped = time.monotonic() + self._max_time_s, False

    def eval(self, arg: list) -> list:
        """Return what is added to every unknown."""
        del arg
        if self.stopped or asked() is not None or time.monotonic() > self._end:
            self.stopped = True
            raise KeyboardInterrupt  # CasADi gives this evaluation up, and the solver stops soon after
        return [0.0]


def _narrowed(lower: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds tightened by what FATROP relaxes them by: limits are promises."""
    low, high = (
        bound + sign * _RELAXED * np.maximum(1.0, np.abs(np.where(np.isfinite(bound), bound, 0.0)))
        for bound, sign in ((lower, 1.0), (upper, -1.0))
    )
    wide = high - low > _RELAXED
    return np.where(wide, low, lower), np.where(wide, high, upper)


def _staged(
    program: Program, stages: Stages, endpoint: Endpoint | None, clock: ca.Callback
) -> tuple[dict[str, ca.Function], np.ndarray, list[int]]:
    """Return a program's functions in stages, the order of its rows and then the copies' in them, and rows by stage."""
    layout, interval, n = program.layout, program.interval, program.layout.n_intervals
    # Every interval reads its duration in its own stage: a segment for each.
    inner = replace(layout, n_segments=n, n_extra=0)
    mesh = Mesh(fraction=np.ones(n), segment=np.arange(n))
    base = build_program(inner, mesh, interval, no_rows(inner.size), np.zeros(inner.size))
    durations = [stages.at(layout.durations()[j], k) for k, j in enumerate(program.mesh.segment)]
    into = np.concatenate([stages.home[: inner.size - n], durations])  # (inner.size,) the y of each unknown of `base`
    n_y, n_p = len(stages.source), base.functions["nlp"].size1_in(1)
    y, p = ca.MX.sym("y", n_y), ca.MX.sym("p", n_p + (endpoint.n_parameters if endpoint else 0))
    timed = y + clock(y[0])
    x, q = timed[into.tolist()], p[:n_p]
    last = np.flatnonzero(stages.stage == n)
    ends = _ends(endpoint, layout, stages, last) if endpoint else None
    at_end = timed[last.tolist()], p[n_p:]
    extra = stages.home[layout.extra()].tolist()  # what there is of it is what is minimised
    pairs, pair_stages = stages.carried_rows()
    linear = _linear(program, stages, pairs)
    n_linear, n_ends = program.linear.shape[0], endpoint.n_rows if endpoint else 0

    # Rows one after another are: intervals', linear, the ends', copies'. In a stage dynamics come first, copies' next.
    own_rank = np.where(np.arange(interval.n_rows) < layout.n_state, 0, 2)
    rank = np.concatenate([np.tile(own_rank, n), np.full(n_linear + n_ends, 2), np.ones(len(pairs), dtype=int)])
    of_rows = np.repeat(np.arange(n), interval.n_rows)
    stage = np.concatenate([of_rows, stages.linear, np.full(n_ends, n), pair_stages])
    order = np.lexsort((np.arange(len(stage)), rank, stage))
    place = np.empty(len(order), dtype=int)
    place[order] = np.arange(len(order))

    f, own_rows = base.functions["nlp"](x, q)
    f += ca.sum1(timed[extra]) + (ends["cost"](*at_end) if ends else 0)
    flat = linear.dm() @ timed
    end_rows = [ends["rows"](*at_end)] if ends else []
    rows = ca.vertcat(own_rows, flat[:n_linear], *end_rows, flat[n_linear:])[order.tolist()]

    J = base.functions["jac_g"]
    i, j = _places(J, 1)
    at_rows = [i, np.where(linear.rows < n_linear, base.n_rows + linear.rows, base.n_rows + n_ends + linear.rows)]
    at_columns, values = [into[j], linear.columns], [_nonzeros(J(x, q)[1]), ca.DM(linear.values)]
    gradient = scatter(into, n_y) @ base.functions["grad_f"](x, q)[1]
    gradient += ca.DM(np.bincount(np.array(extra, dtype=int), minlength=n_y).astype(float))
    if ends:
        i, j = _places(ends["jacobian"], 0)
        at_rows, at_columns = [*at_rows, base.n_rows + n_linear + i], [*at_columns, last[j]]
        values.append(_nonzeros(ends["jacobian"](*at_end)))
        gradient += scatter(last, n_y) @ ends["gradient"](*at_end)
    jacobian = _assembled(values, place[np.concatenate(at_rows)], np.concatenate(at_columns), (len(order), n_y))

    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", len(order))
    lam = lam_g[place.tolist()]
    H = base.functions["hess_lag"]
    i, j = (into[part] for part in _places(H, 0))
    if np.any(stages.stage[i] != stages.stage[j]):
        raise ProblemError(
            'solver.name "fatrop" cannot solve what ties two intervals together beyond their state; "ipopt" can'
        )
    values = [_nonzeros(H(x, q, lam_f, lam[: base.n_rows]))]
    if ends:
        a, b = (last[part] for part in _places(ends["hessian"], 0))
        i, j = np.concatenate([i, a]), np.concatenate([j, b])
        values.append(_nonzeros(ends["hessian"](*at_end, lam_f, lam[base.n_rows + n_linear :][:n_ends])))
    off = np.flatnonzero(i != j)
    upper = ca.vertcat(*values)
    hessian = _assembled([upper, upper[off.tolist()]], np.concatenate([i, j[off]]), np.concatenate([j, i[off]]), (n_y, n_y))

    def function(name: str, inputs: list, outputs: list, names: list[str]) -> ca.Function:
        return ca.Function(name, inputs, outputs, ["x", "p", "lam_f", "lam_g"][: len(inputs)], names)

    # FATROP cycles on values that are not finite: large ones make it backtrack.
    f, rows = _finite(f, _FAR), _finite(rows, _FAR)
    gradient, jacobian, hessian = _finite(gradient), _finite(jacobian), _finite(hessian)
    multiplied = [y, p, lam_f, lam_g]
    lagrangian = lam_f * gradient + jacobian.T @ lam_g
    functions = {
        "nlp": function("nlp", [y, p], [f, rows], ["f", "g"]),
        "nlp_grad_f": function("nlp_grad_f", [y, p], [gradient], ["grad_f_x"]),
        "nlp_jac_g": function("nlp_jac_g", [y, p], [rows, jacobian], ["g", "jac_g_x"]),
        "nlp_hess_l": function("nlp_hess_l", multiplied, [lagrangian, hessian], ["grad_gamma_x", "hess_gamma_x_x"]),
        # Asked once at the end, for the objective and the rows; sensitivities to parameters are not wanted.
        "nlp_grad": function(
            "nlp_grad",
            multiplied,
            [f, rows, lagrangian, ca.DM.zeros(p.numel())],
            ["f", "g", "grad_gamma_x", "grad_gamma_p"],
        ),
    }
    return functions, order, np.bincount(stage[rank == 2], minlength=n + 1).tolist()


def _linear(program: Program, stages: Stages, pairs: np.ndarray) -> Triplets:
    """Return the linear rows in y, each in its stage, then a row (copy - what it copies) for each pair."""
    given, n = program.linear, program.linear.shape[0]
    columns = [stages.at(unknown, stages.linear[row]) for row, unknown in zip(given.rows, given.columns, strict=True)]
    rows = np.concatenate([given.rows, np.repeat(n + np.arange(len(pairs)), 2)])
    values = np.concatenate([given.values, np.tile([1.0, -1.0], len(pairs))])
    columns = np.concatenate([np.array(columns, dtype=int), pairs.ravel()])
    return Triplets(rows=rows, columns=columns, values=values, shape=(n + len(pairs), len(stages.source)))


def _ends(endpoint: Endpoint, layout: Layout, stages: Stages, last: np.ndarray) -> dict[str, ca.Function]:
    """Return the ends' rows and cost with their derivatives, functions of the last stage's unknowns and parameters."""
    n = layout.n_intervals
    y, q = ca.SX.sym("y", len(last)), ca.SX.sym("q", endpoint.n_parameters)

    def read(unknowns: np.ndarray) -> ca.SX:
        # What the endpoint does not depend on is not carried to it: zero does.
        places = [stages.at(unknown, n) - int(last[0]) for unknown in unknowns]
        return ca.vertcat(*[y[place] if place >= 0 else ca.SX(0) for place in places])

    unknowns = endpoint.unknowns(layout.state(0), layout.state(n), layout.dependent()[-1, -1])
    value = endpoint.at(read(np.array(unknowns)), ca.sum1(read(layout.durations())), q, layout.n_state)
    rows, cost = ca.reshape(value[: endpoint.n_rows], endpoint.n_rows, 1), value[endpoint.n_rows]
    lam_f, lam = ca.SX.sym("lam_f"), ca.SX.sym("lam", endpoint.n_rows)
    hessian = ca.triu(ca.hessian(lam_f * cost + ca.dot(lam, rows), y)[0])
    return {
        "rows": ca.Function("ends_rows", [y, q], [rows]),
        "cost": ca.Function("ends_cost", [y, q], [cost]),
        "jacobian": ca.Function("ends_jacobian", [y, q], [ca.jacobian(rows, y)]),
        "gradient": ca.Function("ends_gradient", [y, q], [ca.densify(ca.gradient(cost, y))]),
        "hessian": ca.Function("ends_hessian", [y, q, lam_f, lam], [hessian]),
    }


def _places(function: ca.Function, output: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of an output's nonzeros."""
    rows, columns = function.sparsity_out(output).get_triplet()
    return np.array(rows, dtype=int), np.array(columns, dtype=int)


def _finite(values: ca.MX, otherwise: float = 0.0) -> ca.MX:
    """Return a matrix with another value in place of those that are not finite."""
    flat = _nonzeros(values)
    good = ca.fabs(flat) < _LARGEST
    return ca.MX(values.sparsity(), ca.if_else(good, flat, 0.0) + otherwise * (1 - good))


def _nonzeros(matrix: ca.MX) -> ca.MX:
    """Return a matrix's nonzeros as a column."""
    return ca.vec(matrix.nz[:])


def _assembled(values: list, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> ca.MX:
    """Return the sparse matrix of triplets at places that all differ."""
    order = np.lexsort((rows, columns))
    return ca.MX(pattern(rows[order], columns[order], shape), ca.vertcat(*values)[order.tolist()])
