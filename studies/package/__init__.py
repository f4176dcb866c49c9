"""Optimal-control motion planning for closed-chain mechanisms: MuJoCo model in, certified trajectory out.

    import linkplan

    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    problem = linkplan.Problem.reach(knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16)
    plan = linkplan.plan(problem).require()
    plan.plot("plan.png")
    print(linkplan.compare(plan))

Every name is loaded when it is first used: `import linkplan` itself loads no solver, no simulator and no plots. Names with
`_deg` are in degrees, everything else is in SI units. Invalid input raises a `LinkplanError` with one sentence: the
argument, the legal values, and the given value. Progress is logged under the name "linkplan" and passed to `progress`, if
it is given.
"""

import importlib

TYPE_CHECKING = False  # like that of typing, which takes as long to load as everything else here
if TYPE_CHECKING:  # for editors and type checkers; `_HOMES` below has the same names at run time
    from linkplan.batches import batch
    from linkplan.controllers.trackers.tracker import Tracker
    from linkplan.decompositions import decompose
    from linkplan.experiments import experiment
    from linkplan.first_motion import new
    from linkplan.gains import tune
    from linkplan.loops import bode
    from linkplan.mechanisms import check, load_mechanism
    from linkplan.models.errors import LinkplanError
    from linkplan.models.mechanism import Mechanism
    from linkplan.motors import size
    from linkplan.names import schema
    from linkplan.ode_plans import solve_ocp
    from linkplan.outputs import export, render, report
    from linkplan.planner.ode.problem import OdeProblem
    from linkplan.planner.problem.extra import ExtraCost, ExtraLimit
    from linkplan.planner.problem.problem import Problem
    from linkplan.plans import Plan, Planner, plan, prove, read_plan
    from linkplan.tracking import compare, track
    from linkplan.transfers import transfer
    from linkplan.viewing import demo, explore, view

    __version__: str

__all__ = [
    "ExtraCost",
    "ExtraLimit",
    "LinkplanError",
    "Mechanism",
    "OdeProblem",
    "Plan",
    "Planner",
    "Problem",
    "Tracker",
    "batch",
    "bode",
    "check",
    "compare",
    "decompose",
    "demo",
    "experiment",
    "explore",
    "export",
    "load_mechanism",
    "new",
    "plan",
    "prove",
    "read_plan",
    "render",
    "report",
    "schema",
    "size",
    "solve_ocp",
    "track",
    "transfer",
    "tune",
    "view",
]

# The public names by their modules, loaded when a name is first used (PEP 562). No module of this package has a public name,
# because its import would replace that name by the module.
_MODULES = {
    "linkplan.controllers.trackers.tracker": ("Tracker",),
    "linkplan.decompositions": ("decompose",),
    "linkplan.experiments": ("experiment",),
    "linkplan.gains": ("tune",),
    "linkplan.loops": ("bode",),
    "linkplan.batches": ("batch",),
    "linkplan.mechanisms": ("check", "load_mechanism"),
    "linkplan.models.errors": ("LinkplanError",),
    "linkplan.models.mechanism": ("Mechanism",),
    "linkplan.motors": ("size",),
    "linkplan.names": ("schema",),
    "linkplan.ode_plans": ("solve_ocp",),
    "linkplan.planner.ode.problem": ("OdeProblem",),
    "linkplan.planner.problem.extra": ("ExtraCost", "ExtraLimit"),
    "linkplan.planner.problem.problem": ("Problem",),
    "linkplan.plans": ("Plan", "Planner", "plan", "prove", "read_plan"),
    "linkplan.first_motion": ("new",),
    "linkplan.tracking": ("compare", "track"),
    "linkplan.transfers": ("transfer",),
    "linkplan.viewing": ("demo", "explore", "view"),
    "linkplan.outputs": ("export", "render", "report"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    """Load the module of a public name and return the object."""
    if name == "__version__":
        from importlib.metadata import version

        value: object = version("linkplan")
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
    else:
        raise AttributeError(f"module 'linkplan' has no attribute '{name}'; it has {', '.join(__all__)}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names, loaded or not."""
    return sorted({*globals(), *__all__, "__version__"})
