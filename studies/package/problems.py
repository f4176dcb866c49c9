"""`Problem`: the mechanism, the motion, the objective and the limits, in users' units and names."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from linkplan.models.errors import ProblemError
from linkplan.models.mechanism import Mechanism
from linkplan.models.names import nearest
from linkplan.plain import plain
from linkplan.planner.files.problem_file import file_text, mechanism_from_tables, problem_from_tables
from linkplan.planner.files.tables import read_tables, set_key
from linkplan.planner.keys.reading import KEYS
from linkplan.planner.problem.extra import ExtraCost, ExtraLimit
from linkplan.planner.problem.planning_problem import PlanningProblem
from linkplan.planner.search.presolve import start_pose_of

ByName = Mapping[str, float]
# Arguments of the builders that are whole tables of a problem file, and those that are keys of a table.
_SECTIONS = ("reference", "limits", "motors", "guess", "mesh", "solver", "tracking")
_MOTION = tuple(key for key in KEYS["motion"] if key != "kind")
_EXTRAS = ("extra_costs", "extra_limits")
_MECHANISM = tuple(key for key in KEYS["mechanism"] if key != "model")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Problem:
    """A planning problem, checked as a whole: it is consistent, and the mechanism reaches its poses.

    Made by `Problem.reach`, `.periodic`, `.track` or `.from_file`; varied by `replace` and `with_settings`. All builders
    take the same arguments, in the form of a problem file's tables:

    Args:
        mechanism: from `load_mechanism`, or an argument for it: a built-in name, a path, MJCF text.
        start_deg, goal_deg: angles [deg] of the independent hinges by joint name; dependent hinges may be named, too, and
            are checked against the closed loop. `start_m`, `goal_m`: slides' positions [m].
        start_at, goal_at: instead of joints, positions [m] of the model's sites in the world frame, by name:
            {"foot": [x, y, z]}, or some coordinates, {"foot": {"z": 0.2}}. Inverse kinematics finds the nearest pose to the
            start. The position at the end of a reach may leave the pose open.
        start_speed_deg_s, goal_speed_deg_s: independent speeds [deg/s]; `..._m_s` [m/s] on slides. At rest by default.
        duration_s: a number of seconds, or "free", then within `min_duration_s` and `max_duration_s`, if they are given.
        waypoints: tables in order, with any of `at_deg`, `at_m`, `at` (positions of sites), `speed_deg_s`, `speed_m_s`,
            `time_s`.
        turns: whole turns by joint that a periodic motion makes in a period, {"O": 1}; their sign is the direction.
        minimize: effort, time, tracking, work, copper_loss, effort_rate or closure_force, or a table of weights.
        reference: a sinusoid: `amplitude_deg`, `bias_deg`, `phase_deg` by joint, and `frequency_hz`.
        limits: `effort`, `range_deg`, `speed_deg_s`, `effort_rate`, `power_w`, `closure_force`, each by name, and
            `singular_margin`, `contacts`; `site`, boxes {"foot": {"z": [0.0, inf]}}, walls {"normal": n, "at": p} and tubes
            {"along": points, "radius_m": r}, one or a list by site. By default the model's own.
        motors: by actuator: `torque_constant`, `resistance_ohm`, `stall_effort`, `no_load_speed_deg_s`.
        guess: `path_deg`, positions at equal times by joint, or `plan`, a saved plan's folder.
        mesh: `scheme`, `intervals`, `effort`, `tolerance_deg`, `refine`, `breaks`.
        solver: `starts`, `compile`, `max_time_s`.
        tracking: `kp`, `kd`, `period_s`, `delay_periods`, `duration_s` and the weights of LQR.
        extra_costs: a list of `ExtraCost`, running costs in addition to `minimize`, or the whole objective if that is {}.
        extra_limits: a list of `ExtraLimit`, limits at every instant.
        name: of the problem in messages, tables and files; by default the mechanism's name with the kind of motion.

    Raises:
        LinkplanError: with one sentence, if a problem file with these tables would be refused, or if start, goal, waypoints
            or reference are out of reach.
    """

    planning: PlanningProblem

    def __post_init__(self) -> None:
        if not isinstance(self.planning, PlanningProblem):
            raise ProblemError(
                f"a Problem is made by Problem.reach, .periodic, .track or .from_file, got planning = {self.planning!r}"
            )

    @classmethod
    def reach(
        cls,
        mechanism: Mechanism | str | Path,
        *,
        start_deg: ByName | None = None,
        goal_deg: ByName | None = None,
        duration_s: float | str | None = None,
        minimize: str | ByName | None = None,
        limits: Mapping | None = None,
        waypoints: Sequence[Mapping] | None = None,
        start_m: ByName | None = None,
        goal_m: ByName | None = None,
        start_at: Mapping[str, Sequence[float] | ByName] | None = None,
        goal_at: Mapping[str, Sequence[float] | ByName] | None = None,
        start_speed_deg_s: ByName | None = None,
        goal_speed_deg_s: ByName | None = None,
        start_speed_m_s: ByName | None = None,
        goal_speed_m_s: ByName | None = None,
        min_duration_s: float | None = None,
        max_duration_s: float | None = None,
        reference: Mapping | None = None,
        motors: Mapping[str, Mapping] | None = None,
        guess: Mapping | None = None,
        mesh: Mapping | None = None,
        solver: Mapping | None = None,
        tracking: Mapping | None = None,
        extra_costs: Sequence[ExtraCost] | None = None,
        extra_limits: Sequence[ExtraLimit] | None = None,
        name: str | None = None,
    ) -> Problem:
        """Return the problem of a motion from a start to a goal; the arguments are those of `Problem`.

        Without `duration_s` the duration is free. The default objective is the integral of squared efforts.
        """
        return _built("reach", mechanism, name, locals())

    @classmethod
    def periodic(
        cls,
        mechanism: Mechanism | str | Path,
        *,
        reference: Mapping | None = None,
        start_deg: ByName | None = None,
        goal_deg: ByName | None = None,
        duration_s: float | str | None = None,
        minimize: str | ByName | None = None,
        limits: Mapping | None = None,
        waypoints: Sequence[Mapping] | None = None,
        start_m: ByName | None = None,
        goal_m: ByName | None = None,
        start_at: Mapping[str, Sequence[float] | ByName] | None = None,
        goal_at: Mapping[str, Sequence[float] | ByName] | None = None,
        min_duration_s: float | None = None,
        max_duration_s: float | None = None,
        turns: Mapping[str, int] | None = None,
        motors: Mapping[str, Mapping] | None = None,
        guess: Mapping | None = None,
        mesh: Mapping | None = None,
        solver: Mapping | None = None,
        tracking: Mapping | None = None,
        extra_costs: Sequence[ExtraCost] | None = None,
        extra_limits: Sequence[ExtraLimit] | None = None,
        name: str | None = None,
    ) -> Problem:
        """Return the problem of a motion that returns to its first state; the arguments are those of `Problem`.

        The motion goes from `start_deg` to `goal_deg` in half the period and back, or through `waypoints`, or it follows the
        `reference`. With a reference, the duration is that of its period and the default objective is the tracking error.
        With `turns`, hinges turn by whole turns in every period.
        """
        return _built("periodic", mechanism, name, locals())

    @classmethod
    def track(
        cls,
        mechanism: Mechanism | str | Path,
        *,
        reference: Mapping | None = None,
        duration_s: float | None = None,
        limits: Mapping | None = None,
        motors: Mapping[str, Mapping] | None = None,
        mesh: Mapping | None = None,
        solver: Mapping | None = None,
        tracking: Mapping | None = None,
        extra_limits: Sequence[ExtraLimit] | None = None,
        name: str | None = None,
    ) -> Problem:
        """Return the problem of following a reference exactly; the arguments are those of `Problem`."""
        return _built("track", mechanism, name, locals())

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
        _set(tables, settings)
        return _checked(problem_from_tables(name, tables, folder))

    @property
    def name(self) -> str:
        """The name in messages, tables and files."""
        return self.planning.name

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism."""
        return self.planning.mechanism

    def to_dict(self) -> dict:
        """Return a copy of the problem as the tables of a problem file, without extra costs and limits."""
        return copy.deepcopy(self.planning.source)

    def to_toml(self) -> str:
        """Return the problem as the text of a problem file, from which `from_file` returns the same problem.

        The text does not contain extra costs and limits, which are Python code; a comment in its first line names them.
        """
        return file_text(self.planning)

    def replace(self, **changes: object) -> Problem:
        """Return the problem with new values of some of the builders' arguments; None removes an argument.

        A table, such as `limits`, is replaced as a whole; `with_settings` changes single values in a table. Further
        arguments are `payload`, `home_deg`, `home_m` and `independent`, of the mechanism.

        Raises:
            LinkplanError: for an unknown argument, or as for the builders.
        """
        legal = ("mechanism", *_MECHANISM, *_MOTION, "minimize", *_SECTIONS, *_EXTRAS, "name")
        for key in changes:
            if key not in legal:
                raise ProblemError(
                    f"unknown argument '{key}' of replace{nearest(key, legal)}; arguments are {', '.join(legal)}"
                )
        tables, mechanism = self.to_dict(), self.mechanism
        if changes.get("mechanism") is not None:
            mechanism = _mechanism(changes["mechanism"])
        asked = {key: value for key, value in changes.items() if key in _MECHANISM}
        if asked:
            table = _updated(dict(mechanism.source), asked)
            mechanism = mechanism_from_tables({"mechanism": table})
        _fill(tables, changes)
        name, extras = changes.get("name"), self._extras() | _given_extras(changes)
        return _checked(problem_from_tables(self.name if name is None else _name(name), tables, None, mechanism, **extras))

    def with_settings(self, settings: Mapping[str, object]) -> Problem:
        """Return the problem with new single values in its tables, by dotted key: {"limits.effort.act_O": [-80, 80]}.

        Raises:
            LinkplanError: for an invalid key or value.
        """
        tables = self.to_dict()
        before = copy.deepcopy(tables["mechanism"])
        _set(tables, settings)
        mechanism = self.mechanism if tables["mechanism"] == before else None
        return _checked(problem_from_tables(self.name, tables, None, mechanism, **self._extras()))

    def _extras(self) -> dict:
        return {"extra_costs": self.planning.objective.extra, "extra_limits": self.planning.extra_limits}

    def __repr__(self) -> str:
        motion = self.planning.motion
        duration = "free" if motion.duration_s is None else f"{motion.duration_s:g} s"
        objective = self.planning.objective.name
        return f"Problem({self.name!r}: {motion.kind} of {self.mechanism.name!r}, {objective}, {duration})"


def _built(kind: str, mechanism: object, name: str | None, said: Mapping[str, object]) -> Problem:
    """Return the problem of a builder's arguments, which are among the builder's local variables `said`."""
    tables: dict[str, dict] = {"mechanism": {}, "motion": {"kind": kind}}
    loaded = _mechanism(mechanism)
    _fill(tables, {key: value for key, value in said.items() if value is not None})
    name = f"{loaded.name}-{kind}" if name is None else _name(name)
    return _checked(problem_from_tables(name, tables, None, loaded, **_given_extras(said)))


def _given_extras(said: Mapping[str, object]) -> dict:
    return {key: () if said[key] is None else said[key] for key in _EXTRAS if key in said}


def _checked(planning: PlanningProblem) -> Problem:
    start_pose_of(planning)  # raises if a pose is out of reach
    return Problem(planning=planning)


def _fill(tables: dict, said: Mapping[str, object]) -> None:
    """Put builders' arguments into a file's tables."""
    motion = {key: value for key, value in said.items() if key in _MOTION}
    tables["motion"] = _updated(tables["motion"], motion)
    if "minimize" in said:
        tables["objective"] = _updated(tables.get("objective", {}), {"minimize": said["minimize"]})
    sections = {key: value for key, value in said.items() if key in _SECTIONS}
    tables.update(_updated(tables, sections))
    for key, value in sections.items():
        if value is None:
            tables.pop(key, None)


def _updated(table: Mapping[str, object], said: Mapping[str, object]) -> dict[str, object]:
    """Return a table with new values, without the keys whose new value is None."""
    found = {key: value for key, value in table.items() if key not in said}
    return found | {key: plain(value) for key, value in said.items() if value is not None}


def _set(tables: dict, settings: object) -> None:
    if settings is None:
        return
    if not isinstance(settings, Mapping):
        raise ProblemError(f"settings are a table of section.key = value, got {settings!r}")
    for key, value in settings.items():
        set_key(tables, str(key), plain(value))


def _mechanism(mechanism: object) -> Mechanism:
    if isinstance(mechanism, Mechanism):
        return mechanism
    return mechanism_from_tables({"mechanism": {"model": plain(mechanism)}})


def _name(name: object) -> str:
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > 500:
        raise ProblemError(f"a problem's name is a word of at most 500 characters that can be shown, got {name!r}")
    return name
