"""Optimal-control motion planning for closed-chain mechanisms: MuJoCo model in, certified trajectory out.

    import linkplan

    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    problem = linkplan.Problem.reach(knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16)
    plan = linkplan.plan(problem).require()
    plan.plot("plan.png")
    print(linkplan.compare(plan))

Every name is loaded when it is first used: `import linkplan` itself loads no solver, no simulator and no plots. Names with
`_deg` are in degrees, everything else is in SI units. Invalid input raises a `LinkplanError`; its message states the
argument, the legal values, and the given value. Progress is logged under the name "linkplan" and passed to `progress`, if it
is given.
"""

import importlib

TYPE_CHECKING = False  # replaces typing.TYPE_CHECKING: the import of typing takes as long as all other imports here
if TYPE_CHECKING:  # for editors and type checkers; `_MODULES` below has the same names at run time
    from linkplan.api.batches import batch as batch
    from linkplan.api.experiments import decompose as decompose
    from linkplan.api.experiments import experiment as experiment
    from linkplan.api.first_motion import new as new
    from linkplan.api.loops import bode as bode
    from linkplan.api.loops import tune as tune
    from linkplan.api.mechanisms import check as check
    from linkplan.api.mechanisms import load_mechanism as load_mechanism
    from linkplan.api.motors import size as size
    from linkplan.api.names import schema as schema
    from linkplan.api.outputs import export as export
    from linkplan.api.outputs import render as render
    from linkplan.api.outputs import report as report
    from linkplan.api.plans import Plan as Plan
    from linkplan.api.plans import Planner as Planner
    from linkplan.api.plans import plan as plan
    from linkplan.api.plans import prove as prove
    from linkplan.api.plans import read_plan as read_plan
    from linkplan.api.tracking import compare as compare
    from linkplan.api.tracking import track as track
    from linkplan.api.transfers import transfer as transfer
    from linkplan.api.viewing import demo as demo
    from linkplan.api.viewing import explore as explore
    from linkplan.api.viewing import view as view
    from linkplan.controllers.trackers.tracker import Tracker as Tracker
    from linkplan.models.errors import LinkplanError as LinkplanError
    from linkplan.models.mechanism import Mechanism as Mechanism
    from linkplan.planner.problem.extra import ExtraCost as ExtraCost
    from linkplan.planner.problem.extra import ExtraLimit as ExtraLimit
    from linkplan.planner.problem.phases import Phase as Phase
    from linkplan.planner.problem.phases import PhasedProblem as PhasedProblem
    from linkplan.planner.problem.problem import Problem as Problem
    from linkplan.studies.output.phased_plan import PhasedPlan as PhasedPlan

    __version__: str

# The public names by their modules, loaded when a name is first used (PEP 562); the help lists commands in this order.
_MODULES = {
    "linkplan.api.mechanisms": ("check", "load_mechanism"),
    "linkplan.api.plans": ("Plan", "Planner", "plan", "prove", "read_plan"),
    "linkplan.api.batches": ("batch",),
    "linkplan.api.motors": ("size",),
    "linkplan.api.tracking": ("compare", "track"),
    "linkplan.api.experiments": ("experiment", "decompose"),
    "linkplan.api.loops": ("bode", "tune"),
    "linkplan.api.transfers": ("transfer",),
    "linkplan.api.viewing": ("demo", "explore", "view"),
    "linkplan.api.outputs": ("export", "render", "report"),
    "linkplan.api.first_motion": ("new",),
    "linkplan.api.names": ("schema",),
    "linkplan.controllers.trackers.tracker": ("Tracker",),
    "linkplan.models.errors": ("LinkplanError",),
    "linkplan.models.mechanism": ("Mechanism",),
    "linkplan.planner.problem.extra": ("ExtraCost", "ExtraLimit"),
    "linkplan.planner.problem.phases": ("Phase", "PhasedProblem"),
    "linkplan.planner.problem.problem": ("Problem",),
    "linkplan.studies.output.phased_plan": ("PhasedPlan",),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}
__all__ = sorted(_HOMES)  # pyright: ignore[reportUnsupportedDunderAll]  its names are those of the imports above


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
