"""The planning problem: a mechanism, a motion, an objective and limits, checked as a whole when it is built."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from linkplan.models.audit import audit
from linkplan.models.deadline import one_thread_at_a_time
from linkplan.models.mechanism import Mechanism
from linkplan.planner.files.tables import Tables, apply_override, read_tables
from linkplan.planner.problem import build, consistency
from linkplan.planner.problem.extra import Extra, ExtraCost, ExtraLimit, checked_extras, take_jerk
from linkplan.planner.problem.instant import Robust
from linkplan.planner.problem.keys.limits import Motor
from linkplan.planner.problem.limits import Limits
from linkplan.planner.problem.motion import Motion, start_pose
from linkplan.planner.problem.objective import Objective, objective_from
from linkplan.planner.problem.path import SitePath, check_path
from linkplan.planner.problem.reference import GuessedPath, Reference
from linkplan.planner.problem.settings import MeshSettings, SolverSettings, Tracking
from linkplan.planner.problem.sites import BodyAngle, SitePoint
from linkplan.planner.trajectory import Trajectory


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Problem:
    """A planning problem, checked as a whole: it is consistent, and the mechanism reaches its poses.

    Made by `Problem.reach`, `.hold`, `.periodic`, `.track`, `.follow` or `.from_file`; varied by `replace` and
    `with_settings`. All builders take the same arguments, in the form of a problem file's tables:

    Args:
        mechanism: from `load_mechanism`, or an argument for it: a built-in name, a path, MJCF text. The keys of [mechanism]
            are arguments, too, such as `payload` and `home_deg`.
        start_deg, goal_deg: angles [deg] of the independent hinges by joint name; dependent hinges may be named, too, and
            are checked against the closed loop. `start_m`, `goal_m`: slides' positions [m].
        start_at, goal_at: instead of joints, positions [m] of the model's sites in the world frame, by name:
            {"foot": [x, y, z]}, or some coordinates, {"foot": {"z": 0.2}}. Inverse kinematics finds the nearest pose to the
            start. The position at the end of a reach may leave the pose open.
        start_body_deg, goal_body_deg: angles [deg] of bodies by name, instead of joints or beside sites: {"shank": 40.0}.
        start_speed_deg_s, goal_speed_deg_s: independent speeds [deg/s]; `..._m_s` [m/s] on slides. At rest by default.
        duration_s: a number of seconds, or "free", then within `min_duration_s` and `max_duration_s`, if they are given.
        waypoints: tables in order, with any of `at_deg`, `at_m`, `at` (positions of sites), `body_deg`, `speed_deg_s`,
            `speed_m_s`, `time_s`.
        turns: whole turns by joint that a periodic motion makes in a period, {"O": 1}; their sign is the direction.
        minimize: effort, time, tracking, work, copper_loss, effort_rate, jerk, peak_effort, closure_force, or a table of
            weights.
        reference: a sinusoid, `amplitude_deg`, `bias_deg`, `phase_deg` by joint and `frequency_hz`; or rows, `time_s` with
            `position_deg`, `position_m` by joint or `at`, {"foot": {"x": [...], "z": [...]}}, and `body_deg`, or the `file`
            of a table; with `period_s` and `spline`.
        force_over_time: forces on sites, `time_s` with `on`, {"foot": {"z": [...]}} [N], or the `file` of a table; with
            `period_s` and `interpolation`.
        path: `site` with `points` [m] or a `file`, and `shape`, "polyline", "spline" or "arc", and `blend_m`, of `follow`.
        limits: the keys of [limits], such as `effort`, `range_deg`, `speed_deg_s` and `closure_force`, each by name, and
            `contacts`; `site`, boxes {"foot": {"z": [0.0, inf]}}, walls {"normal": n, "at": p} and tubes {"along": points,
            "radius_m": r}, one or a list by site; `body_deg`, [low, high] by body. By default the model's own.
        reserve: the share of every effort range that is reserved for feedback, such as 0.2; also a key of `limits`.
        motors: by actuator: `torque_constant`, `resistance_ohm`, `stall_effort`, `no_load_speed_deg_s`.
        guess: `path_deg`, positions at equal times by joint, or `plan`, a saved plan's folder.
        mesh, solver: `scheme`, `intervals`, `effort`, `tolerance_deg`, `refine`, `breaks`; `starts`, `compile`, `max_time_s`
        tracking: `kp`, `kd`, `period_s`, `delay_periods`, `duration_s` and the weights of LQR.
        robust, imperfections: as in files: {"payload_factor": [0.8, 1.2]}, {"delay_periods": [0.5, 2.0]} (`experiment`).
        extra_costs: a list of `ExtraCost`, running costs in addition to `minimize`, or the whole objective if that is {}.
        extra_limits: a list of `ExtraLimit`, limits at every instant.
        name: of the problem in messages, tables and files; by default the mechanism's name with the kind of motion.

    Raises:
        LinkplanError: with one sentence, if a problem file with these tables would be refused, or if start, goal, waypoints
            or reference are out of reach.

    `from_tables`, and `dataclasses.replace`, by which the planner varies a problem, check consistency only. `source` is the
    problem as a file's tables with every value that was set, as `plan.json` keeps it.

    Example::

        knee = linkplan.load_mechanism("optimus-knee", payload="shank")
        reach = linkplan.Problem.reach(knee, start_deg={"O": -49.07}, goal_deg={"O": 56.27}, duration_s=0.16)
    """

    name: str
    mechanism: Mechanism
    motion: Motion
    objective: Objective  # or a term's name, or a mapping of weights
    limits: Limits
    extra_limits: Sequence[ExtraLimit] = ()
    robust: Robust = field(default_factory=Robust)
    motors: tuple[Motor | None, ...] = ()
    reference: Reference | None = None
    path: SitePath | None = None
    guess: GuessedPath | Trajectory | None = None
    mesh: MeshSettings = field(default_factory=MeshSettings)
    solver: SolverSettings = field(default_factory=SolverSettings)
    tracking: Tracking = field(default_factory=Tracking)
    source: dict = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # sentences on automatic choices
    unread_extras: tuple = ()  # records of extra limits and costs of a saved plan, whose files lack the expressions

    @classmethod
    @build.with_arguments
    def reach(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of a motion from a start to a goal; the arguments are those of `Problem`.

        Without `duration_s` the duration is free. The default objective is the integral of squared efforts.
        """
        return cls._built("reach", mechanism, arguments)

    @classmethod
    @build.with_arguments
    def hold(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of holding a pose at rest with least efforts; the arguments are those of `Problem`."""
        return cls._built("hold", mechanism, arguments)

    @classmethod
    @build.with_arguments
    def periodic(cls, mechanism: Mechanism | str | Path, **arguments: Any) -> Problem:
        """Return the problem of a motion that returns to its first state; the arguments are those of `Problem`.

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
        """Return the problem of a site that follows a path exactly; the arguments are those of `Problem`.

        It goes from rest at the first point of `path` to rest at the last. `start_deg` selects the nearest of the poses
        there.
        """
        return cls._built("follow", mechanism, arguments)

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
        if settings is not None:
            build.apply_settings(tables, settings)
        return cls.from_tables(name, tables, folder)._in_reach()

    @classmethod
    @one_thread_at_a_time
    def from_tables(
        cls,
        name: str,
        tables: Tables,
        folder: Path | None = None,
        mechanism: Mechanism | None = None,
        *,
        extra_costs: Sequence[ExtraCost] = (),
        extra_limits: Sequence[ExtraLimit] = (),
    ) -> Problem:
        """Return the problem of a file's tables; it is consistent, but its poses may be out of reach.

        Args:
            name: the problem's name.
            tables: as `tomllib` reads them; they are not changed.
            folder: the file's folder, in which paths are looked up before the working folder.
            mechanism: a loaded mechanism that replaces [mechanism].
            extra_costs: running costs as expressions, which tables cannot hold.
            extra_limits: path limits as expressions.

        Raises:
            ProblemError: for anything in the tables that cannot be used.
            ModelError: when their mechanism cannot be built.
        """
        return cls(name=name, extra_limits=extra_limits, **build.problem_arguments(tables, folder, mechanism, extra_costs))

    @classmethod
    def _built(cls, kind: str, model: Mechanism | str | Path, arguments: Mapping[str, object]) -> Problem:
        """Return the problem of a builder's arguments."""
        build.refuse_unknown_arguments(arguments, kind)
        given = {key: value for key, value in arguments.items() if value is not None}
        mechanism = build.asked_mechanism(given | {"mechanism": model})
        name = given.get("name", f"{mechanism.name}-{kind}")
        return cls._varied(name, {"mechanism": {}, "motion": {"kind": kind}}, mechanism, given, {})

    @classmethod
    def _varied(
        cls, name: object, tables: Tables, mechanism: Mechanism, said: Mapping[str, object], extras: dict
    ) -> Problem:
        """Return the problem of tables and extra costs and limits, with a builder's arguments in place of their values."""
        build.fill(tables, said)
        every = extras | build.given_extras(said)
        return cls.from_tables(build.checked_name(name), tables, None, mechanism, **every)._in_reach()

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
        """The indices in the model of all sites that the problem names, by name: start, waypoints, goal, limits."""
        points = [task for task in self.motion.tasks if isinstance(task, SitePoint)]
        paths = () if self.path is None else (self.path,)
        return {one.site: one.index for one in (*points, *self.limits.site, *paths)}

    @property
    def bodies(self) -> dict[str, int]:
        """The indices in the model of all bodies whose angle the problem names, by name: in motion, limits or reference."""
        angles = [task for task in self.motion.tasks if isinstance(task, BodyAngle)]
        tracked = self.source.get("reference", {}).get("body_deg", {})
        known = {one.body: one.index for one in (*angles, *self.limits.body)}
        return known | {name: self.mechanism.model.body(name).id for name in tracked}

    @property
    def not_honoured(self) -> tuple[str, ...]:
        """Phrases on the parts of the model that plans neglect; each states if this makes plans wrong."""
        false = "neglected, which makes the plan wrong: "
        return tuple(f"{false if one.falsifies else ''}{one.text}" for one in audit(self.mechanism.model))

    def to_dict(self) -> dict:
        """Return a copy of the problem as the tables of a problem file, without extra costs and limits."""
        return copy.deepcopy(self.source)

    def to_toml(self) -> str:
        """Return the problem as the text of a problem file, from which `from_file` returns the same problem.

        Extra costs and limits are Python code and not in it; a comment in its first line names them.
        """
        return build.file_text(self.source, self.extras)

    @build.with_arguments
    def replace(self, **changes: Any) -> Problem:
        """Return the problem with new values of some of the builders' arguments, or `mechanism`; None removes an argument.

        A table, such as `limits`, is replaced as a whole; `with_settings` changes single values in a table.

        Raises:
            LinkplanError: for an unknown argument, or as for the builders.
        """
        build.refuse_unknown_arguments(changes, "replace")
        mechanism = build.asked_mechanism(changes, self.mechanism)
        name = self.name if changes.get("name") is None else changes["name"]
        return self._varied(name, self.to_dict(), mechanism, changes, self._extras())

    def with_settings(self, settings: Mapping[str, object]) -> Problem:
        """Return the problem with new single values in its tables, by dotted key: {"limits.effort.act_O": [-80, 80]}.

        Raises:
            LinkplanError: for an invalid key or value.
        """
        tables = self.to_dict()
        build.apply_settings(tables, settings)
        mechanism = self.mechanism if tables["mechanism"] == self.source["mechanism"] else None
        return self.from_tables(self.name, tables, None, mechanism, **self._extras())._in_reach()

    def _extras(self) -> dict:
        return {"extra_costs": self.objective.extra, "extra_limits": self.extra_limits}

    def __post_init__(self) -> None:
        object.__setattr__(self, "objective", objective_from(self.objective))
        object.__setattr__(self, "motors", tuple(self.motors) or (None,) * self.mechanism.n_u)
        object.__setattr__(self, "tracking", self.tracking.tracked())
        consistency.check_honoured(self.mechanism, self.limits.unhonoured)
        object.__setattr__(self, "extra_limits", checked_extras(self.extra_limits, ExtraLimit, "extra_limits"))
        lacking = consistency.lacking_parts(self.motion, self.mechanism, self.motors, self.reference, self.mesh, self.limits)
        jerk = [take_jerk(extra, self.mechanism, lacking["changing accelerations"]) for extra in self.extras]
        jerk += [bool(self.limits.site_jerk), bool(np.any(np.isfinite(self.limits.jerk)))]
        consistency.check_motion(self.motion, self.objective, self.reference)
        others = {"[reference]": self.reference, "[robust]": self.robust.corners, "[guess]": self.guess}
        # Along a path the joints' jerk differs from that of the only coordinate.
        others |= {"minimize 'jerk'": self.objective.has("jerk")}
        bent = self.path is not None and len(self.path.curve.corners) > 0
        smooth_only = "a limit or cost on jerk along rounded corners or a spline, only along a line or an arc"
        others |= {smooth_only: bent and any(jerk)}
        if self.path is not None or self.motion.kind == "follow":
            check_path(self.path, self.motion.kind, others)
        consistency.check_objective(self.objective, self.motion, self.mechanism, self.limits, lacking)
        if len(self.limits.closure_force) == 0:
            limits = replace(self.limits, closure_force=np.full(len(self.mechanism.closure_names), np.inf))
            object.__setattr__(self, "limits", limits)
        consistency.check_turning_joints(self.motion, self.mechanism, self.limits)
        consistency.check_guess(self.guess, self.mechanism)
        consistency.check_periods(self.motion, self.reference, self.mesh)
        consistency.check_robust(self.robust, self.mechanism)
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
