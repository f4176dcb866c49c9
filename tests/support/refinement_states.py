"""States of a refinement for its decisions and records, without any solve."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from linkplan.planner.problem.settings import MeshSettings
from linkplan.planner.refinement.case import CertifiedIterate, ErrorReport, RefinementTarget
from linkplan.planner.refinement.state import RefinementState, observed
from linkplan.planner.solvers.solve import SUCCEEDED
from linkplan.planner.transcription.mesh import uniform

AIMS = RefinementTarget(
    effort_limit=np.array([[-1.0, 1.0]]),
    switches=False,
    bang_bang=False,
    continuous_efforts=True,
    strictness=1.0,
    tolerance_given=False,
    objective_tolerance=None,
)


def solution(objective: float = 1.0, *, n: int = 10, tightened: bool = False) -> SimpleNamespace:
    """Return a solution that the solver converged to, without held arcs."""
    mesh = uniform(n)
    layout = SimpleNamespace(n_u=1, durations=lambda: np.array([0]), effort=lambda: np.zeros((n, 1), dtype=int))
    program = SimpleNamespace(mesh=mesh, layout=layout, interval=SimpleNamespace(n_path=0, own_kinds=(), own_items=()))
    formulation = SimpleNamespace(tightening=object() if tightened else None)
    transcribed = SimpleNamespace(
        program=program,
        bang_efforts=None,
        constrained_paths=None,
        formulation=formulation,
        units=SimpleNamespace(time_s=1.0),
    )
    return SimpleNamespace(
        transcribed=transcribed, objective=objective, status=SUCCEEDED, multipliers=None, x=np.array([1.0])
    )


def iterate(
    *,
    passed: bool = True,
    exact: bool = True,
    growth=(0.0,),
    overrun=(0.0,),
    effort_overrun=(0.0,),
    n: int = 10,
    objective=1.0,
    tightened=False,
    **report,
) -> CertifiedIterate:
    """Return a certified iterate on n even intervals; growth and overrun (n,) or the same on all."""
    motion = SimpleNamespace(breaks_s=np.linspace(0.0, 1.0, n + 1), effort=np.ones((3, n, 1)))
    found = SimpleNamespace(
        motion=motion, solution=solution(objective, n=n, tightened=tightened), fixed=None, mesh=uniform(n)
    )
    overrun = np.broadcast_to(np.array(overrun, dtype=float), n)
    report = ErrorReport(
        exact=exact,
        repairable=report.pop("repairable", True),
        leaves_positions=report.pop("leaves_positions", False),
        overruns=bool(overrun.any()),
        overrun=overrun,
        integration_error_deg=1e-3,
        **report,
    )
    growth = np.broadcast_to(np.array(growth, dtype=float), n)
    beyond = np.broadcast_to(np.array(effort_overrun, dtype=float), n)
    certificate = SimpleNamespace(passed=passed, growth=growth, residual_share=np.zeros(n), effort_overrun=beyond)
    return CertifiedIterate(found=found, certificate=certificate, report=report)


def state(at: CertifiedIterate, *, target: RefinementTarget = AIMS, scheme: str = "radau-3", **changes) -> RefinementState:
    """Return a state at an iterate, its history as `changes` say."""
    problem = SimpleNamespace(mesh=MeshSettings(intervals=10, scheme=scheme))
    case = SimpleNamespace(problem=problem, target=target)
    begin = RefinementState(asked=case, case=case, iterate=at, warm=False)
    return replace(observed(begin, at), **changes)
