"""The planning problem: a mechanism, a motion, an objective and limits, checked as a whole when it is built."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import Tables, apply_override, read_tables
from linkplan.planner.problem import build, consistency
from linkplan.planner.problem.extra import Extra, ExtraCost, ExtraLimit, checked_extras, take_jerk
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.keys.limits import Motor
from linkplan.planner.problem.keys.sections import ProblemFile
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.motion import Motion, start_pose
from linkplan.planner.problem.objective import Objective, objective_from
from linkplan.planner.problem.parameters import parameter_values, read_parameters
from linkplan.planner.problem.path import SitePath, check_path
from linkplan.planner.problem.phases import Phase, PhasedProblem
from linkplan.planner.problem.reference import GuessedPath, Reference
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking, to_toml_types
from linkplan.planner.problem.sites import BodyAngle, SitePoint
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Problem:
    """A planning problem, checked as a whole: it is consistent, and the mechanism reaches its poses.

    Made by `Problem.reach`, `.hold`, `.periodic`, `.track`, `.follow` or `.from_file`; varied by `replace`. Their arguments
    are the keys of problem files; `help(Problem.reach)` lists them.

    `sections` are the problem: the decoded sections of its file, in the file's units, without the keys that have their
    defaults. Problems with equal names, sections, costs and limits are equal. All other values follow from them, in SI.

    Args:
        name: of the problem in messages, tables and files.
        sections: the sections, or tables of a problem file.
        extra_costs: running costs in addition to `minimize`, or the whole objective if that is {}.
        extra_limits: limits at every instant.
        unread_extras: records of extra limits and costs of a saved plan, whose files lack the expressions.
        remarks: sentences on how it was read; `notes` has them, too.
        folder: in which paths are looked up before the working folder.
        loaded: a loaded mechanism that replaces [mechanism].

    Raises:
        LinkplanError: with one sentence, if a problem file with these sections would be refused.

    Example::

        knee = linkplan.load_mechanism("optimus-knee", payload="shank")
        reach = linkplan.Problem.reach(knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16)
        faster = reach.replace("motion.duration_s", 0.15)
    """

    name: str
    sections: ProblemFile
    extra_costs: Sequence[ExtraCost] = ()
    extra_limits: Sequence[ExtraLimit] = ()
    unread_extras: tuple = ()
    remarks: tuple[str, ...] = ()
    folder: InitVar[Path | None] = None
    loaded: InitVar[Mechanism | None] = None
    mechanism: Mechanism = field(init=False)
    motion: Motion = field(init=False)
    objective: Objective = field(init=False)
    limits: Limits = field(init=False)
    robust: Robust = field(init=False)
    motors: tuple[Motor | None, ...] = field(init=False)
    reference: Reference | None = field(init=False)
    path: SitePath | None = field(init=False)
    guess: GuessedPath | Trajectory | None = field(init=False)
    mesh: MeshSettings = field(init=False)
    solver: SolverSettings = field(init=False)
    tracking: Tracking = field(init=False)
    notes: tuple[str, ...] = field(init=False)  # sentences on automatic choices
    tracked_bodies: Sequence[str] = field(init=False)  # bodies whose angles the reference prescribes
    shown_sites: Sequence[str] = field(init=False)  # sites of [output]

    @classmethod
    @build.with_arguments
    def reach(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of a motion from a start to a goal.

        Without `duration_s` the duration is free. The default objective is the integral of squared efforts.
        """
        return cls._built("reach", mechanism, arguments)

    @classmethod
    @build.with_arguments
    def hold(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of holding a pose at rest with least efforts."""
        return cls._built("hold", mechanism, arguments)

    @classmethod
    @build.with_arguments
    def periodic(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of a motion that returns to its first state.

        The motion goes from `start_deg` to `goal_deg` in half the period and back, or through `waypoints`, or it follows the
        `reference`. With a reference, the duration is that of its period and the default objective is the tracking error.
        With `turns`, hinges turn by whole turns in every period.
        """
        return cls._built("periodic", mechanism, arguments)

    @classmethod
    @build.with_arguments
    def track(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of following a reference exactly; the arguments are those of `Problem`."""
        return cls._built("track", mechanism, arguments)

    @classmethod
    @build.with_arguments
    def follow(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of a site that follows a path exactly.

        It goes from rest at the first point of `path` to rest at the last. `start_deg` selects the nearest of the poses
        there.
        """
        return cls._built("follow", mechanism, arguments)

    @classmethod
    def phases(cls, mechanism: Mechanism | str | Path, phases: Sequence[Phase], **tables: Any) -> PhasedProblem:
        """Return the problem of a motion in phases with contacts, a `PhasedProblem`.

        Args:
            mechanism: without contacts.
            phases: `Phase`s in order, or tables.
            tables: the other tables of a file: contacts, motion, objective, limits; and a name.

        Raises:
            LinkplanError: if they are invalid.
        """
        return PhasedProblem.of(mechanism, phases, tables)

    @classmethod
    def from_file(cls, path_or_name: str | Path, settings: Mapping[str, object] | None = None) -> Problem:
        """Return the problem of a built-in name or a TOML file.

        Args:
            path_or_name: a built-in name (listed by `linkplan list`) or a path. Paths in a file are relative to its folder,
                else to the working folder.
            settings: values that replace those of the file, by dotted key: {"motion.duration_s": 0.2}.

        Raises:
            LinkplanError: if the file or the settings are invalid.
        """
        name, tables, folder = read_tables(path_or_name)
        build.apply_settings(tables, settings or {})
        return cls.from_tables(name, tables, folder)._in_reach()

    @classmethod
    def from_tables(
        cls,
        name: str,
        tables: Tables,
        folder: Path | None = None,
        mechanism: Mechanism | None = None,
        **extras: Any,
    ) -> Problem:
        """Return the problem of a file's tables, as `tomllib` reads them; it is consistent, but may be out of reach.

        The arguments are those of `Problem`, with `mechanism` for `loaded`.
        """
        if "phases" in tables:
            raise ProblemError(
                f"problem '{name}' has phases: `plan`, `check`, `track`, `compare`, `render` and `batch` take it, and other"
                " commands the folder of one phase of its plan"
            )
        sections: Any = tables
        return cls(name=name, sections=sections, folder=folder, loaded=mechanism, **extras)

    @classmethod
    def _built(cls, kind: str, model: Mechanism | str | Path, arguments: Mapping[str, object]) -> Problem:
        """Return the problem of a builder's arguments."""
        build.refuse_unknown_arguments(arguments, kind)
        given = {key: value for key, value in arguments.items() if value is not None}
        mechanism = build.asked_mechanism(given | {"mechanism": model})
        tables: Tables = {"mechanism": {}, "motion": {"kind": kind}}
        build.fill(tables, given)
        name = build.checked_name(given.get("name", f"{mechanism.name}-{kind}"))
        return cls.from_tables(name, tables, None, mechanism, **build.given_extras(given))._in_reach()

    def start_pose(self) -> np.ndarray:
        """Return the closed pose (n_q,) at the start.

        Raises:
            ProblemError: if start, goal, waypoints or reference are beyond reach, or for impossible turns.
        """
        return start_pose(self.mechanism, self.motion, self.limits, self.reference, self.solver.deadline)

    def _in_reach(self) -> Problem:
        """Return this problem if the mechanism reaches its poses."""
        self.start_pose()
        return self

    def reference_over(self, duration_s: float) -> Reference | None:
        """Return the reference for a duration [s]; a reference tracked in a free duration is stretched to it."""
        if self.reference is None or self.motion.kind != "track" or self.motion.duration_s is not None:
            return self.reference
        return self.reference.stretched(duration_s / self.reference.period_s)

    @property
    def free_at_end(self) -> np.ndarray:
        """A mask (n_s,) of coordinates with a free final state: passive and coasting ones that the goal does not name."""
        named = np.isin(np.arange(self.mechanism.dof), list(self.motion.goal_named))
        return ~self.mechanism.actuated & ~named

    @property
    def free_spins(self) -> np.ndarray:
        """A mask (n_s,) of free coordinates that need not return in a periodic motion: spins that affect nothing else."""
        return self.free_at_end & self.mechanism.cyclic

    @property
    def extras(self) -> tuple[Extra, ...]:
        """The users' own limits and costs."""
        return (*self.extra_limits, *self.objective.extra)

    @property
    def sites(self) -> dict[str, int]:
        """The indices in the model of all sites that the problem names, by name: motion, limits, path, output."""
        points = [task for task in self.motion.tasks if isinstance(task, SitePoint)]
        paths = () if self.path is None else (self.path,)
        limits = self.limits
        named = (*limits.site_speed, *limits.site_acceleration, *limits.site_jerk, *self.shown_sites)
        known = {one.site: one.index for one in (*points, *limits.site, *paths)}
        return known | {name: self.mechanism.model.site(name).id for name in named}

    @property
    def tolerances(self) -> dict[str, tuple[float, float]]:
        """The largest error and the standard deviation [SI] of the parameters whose tables have one of them."""
        tables = {} if self.sections is None else read_parameters(self.sections.to_dict().get("parameters", {}))
        return {name: errors for name, one in tables.items() if (errors := one.errors) is not None}

    @property
    def bodies(self) -> dict[str, int]:
        """The indices in the model of all bodies whose angle the problem names, by name: in motion, limits or reference."""
        angles = [task for task in self.motion.tasks if isinstance(task, BodyAngle)]
        known = {one.body: one.index for one in (*angles, *self.limits.body)}
        return known | {name: self.mechanism.model.body(name).id for name in self.tracked_bodies}

    @property
    def objective_unit(self) -> str:
        """The unit of an objective with one term, for this mechanism's hinges or slides; empty for a sum of terms."""
        unit, term = self.objective.unit, next(iter(self.objective.weights), "")
        if unit and term.startswith("effort"):
            of_kind = {"N.m": unit, "N": unit.replace("N2 m2", "N2")}
            return " and ".join(dict.fromkeys(of_kind[actuator.unit] for actuator in self.mechanism.actuators))
        if unit and term == "tracking":
            of_slides = unit.replace("rad2", "m2")
            units = (unit if joint.kind == "hinge" else of_slides for joint in self.mechanism.independent_joints)
            return " and ".join(dict.fromkeys(units))
        return unit

    @property
    def not_honoured(self) -> tuple[str, ...]:
        """Phrases on the parts of the model that plans neglect; each states if this makes plans wrong."""
        false = "neglected, which makes the plan wrong: "
        return tuple(f"{false if one.falsifies else ''}{one.text}" for one in audit(self.mechanism.model))

    def to_dict(self) -> dict:
        """Return the problem as the tables of a problem file, without extra costs and limits."""
        if self.sections is None:
            raise ProblemError(f"problem '{self.name}' was varied in SI, which no file can contain; vary it by `replace`")
        return self.sections.to_dict()

    def to_toml(self) -> str:
        """Return the problem as the text of a problem file, from which `from_file` returns the same problem.

        Extra costs and limits are Python code and not in it; a comment in its first line names them.
        """
        return build.file_text(self.to_dict(), self.extras)

    @build.with_arguments
    def replace(self, key: str | Mapping[str, object] = "", value: object = None, /, **changes: Any) -> Problem:
        """Return the problem with new values, read and checked as those of a file. None stands for the default.

        Example::

            problem.replace("motion.duration_s", 0.3)
            problem.replace({"limits.effort.act_O": [-80, 80], "tracking.kp": 50})
            problem.replace(duration_s=0.3, limits={"reserve": 0.1})

        Args:
            key: the dotted key of a value, as for `--set`; or several with their values.
            value: the value of a single key.
            changes: arguments of the builders, or whole sections.

        Raises:
            LinkplanError: for an unknown key or argument, or as for the builders.
        """
        build.refuse_unknown_arguments(changes, "replace")
        mechanism, tables = build.asked_mechanism(changes, self.mechanism), self.to_dict()
        tables["mechanism"] = build.table_of(mechanism)
        build.fill(tables, changes)
        build.apply_settings(tables, {key: value} if isinstance(key, str) and key else key or {})
        own = {name: getattr(self, name) for name in ("extra_costs", "extra_limits", "unread_extras", "remarks")}
        name = build.checked_name(changes.get("name") or self.name)
        values = parameter_values(tables.get("parameters", {}))
        same = tables["mechanism"] == build.table_of(mechanism)
        same = mechanism if same and values == parameter_values(build.parameters_of(mechanism)) else None
        return self.from_tables(name, tables, None, same, **own | build.given_extras(changes))._in_reach()

    def varied(self, **values: Any) -> Problem:
        """Return what a `Case` solves in place of this problem: it has other values in SI, and no sections."""
        problem = copy.copy(self)
        for name, value in ({"sections": None} | values).items():
            object.__setattr__(problem, name, value)
        problem._check()
        return problem

    def __eq__(self, other: object) -> bool:
        if self is other or not isinstance(other, Problem) or self.sections is None:
            return self is other
        names = ("name", "sections", "extra_costs", "extra_limits")
        return all(getattr(self, one) == getattr(other, one) for one in names)

    def __hash__(self) -> int:
        return hash(self.name)

    @one_thread_at_a_time
    def __post_init__(self, folder: Path | None, loaded: Mechanism | None) -> None:
        extra_costs = checked_extras(self.extra_costs, ExtraCost, "extra_costs")
        found = build.values_of(to_toml_types(self.sections), folder, loaded, extra_costs)
        sections = found["sections"]
        found |= {"extra_costs": extra_costs, "notes": (*self.remarks, *found["notes"])}
        found["shown_sites"] = tuple(sections.output.sites)
        found["tracked_bodies"] = () if sections.reference is None else tuple(sections.reference.body_deg)
        for name, value in found.items():
            object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        """Refuse values that contradict each other or the mechanism."""
        object.__setattr__(self, "objective", objective_from(self.objective))
        consistency.check_honoured(self.mechanism, self.limits.unhonoured)
        object.__setattr__(self, "extra_limits", checked_extras(self.extra_limits, ExtraLimit, "extra_limits"))
        lacking = consistency.lacking_parts(self.motion, self.mechanism, self.motors, self.reference, self.mesh, self.limits)
        jerk = [take_jerk(extra, self.mechanism, lacking["changing accelerations"]) for extra in self.extras]
        jerk += [bool(self.limits.site_jerk), bool(np.any(np.isfinite(self.limits.jerk)))]
        consistency.check_motion(self.motion, self.objective, self.reference)
        others = {"[reference]": self.reference, "[robust]": self.robust.corners, "[guess]": self.guess}
        # Along a path the joints' jerk differs from that of the only coordinate.
        others |= {"minimize 'jerk'": self.objective.has("jerk")}
        bent = self.path is not None and not self.path.curve.is_smooth
        smooth_only = (
            "a limit on jerk along a spline, or one in Python along rounded corners, only along a polyline or an arc"
        )
        others |= {smooth_only: bent and any(jerk)}
        if self.path is not None or self.motion.kind == "follow":
            check_path(self.path, self.motion.kind, others)
        consistency.check_objective(self.objective, self.motion, self.mechanism, self.limits, lacking)
        consistency.check_turning_joints(self.motion, self.mechanism, self.limits)
        consistency.check_guess(self.guess, self.mechanism)
        consistency.check_periods(self.motion, self.reference, self.mesh)
        consistency.check_robust(self.robust, self.mechanism)
        own = np.any(np.isfinite(self.limits.jerk[self.mechanism.independent]), axis=1)
        every = self.objective.has("jerk") or any(jerk[:-1]) or np.any(np.isfinite(self.limits.effort_rate))
        consistency.check_end_accelerations(self.motion, self.mechanism, own | every)
        consistency.check_open_goal(self.motion, self.mechanism, self.limits, self.mesh)
        consistency.check_node_at_end(self.motion, self.mechanism, self.mesh)

    def __repr__(self) -> str:
        motion = self.motion
        duration = "free" if motion.duration_s is None else f"{motion.duration_s:g} s"
        return f"Problem({self.name!r}: {motion.kind} of {self.mechanism.name!r}, {self.objective.name}, {duration})"


def load_problem(source: str | Path, overrides: Sequence[str] = ()) -> Problem:
    """Return the problem of a built-in name or a TOML file, with `key=value` overrides applied.

    Raises:
        ProblemError: for anything in the file or an override that cannot be used.
        ModelError: when its mechanism cannot be built.
    """
    name, tables, folder = read_tables(source)
    for override in overrides:
        apply_override(tables, override)
    return Problem.from_tables(name, tables, folder)
