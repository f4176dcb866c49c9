"""`Problem`: which motion of which mechanism, best in which sense, within which limits; stated in users' units and names."""

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
# Arguments of the builders that are whole tables of a problem file, and those that are keys of one.
_SECTIONS = ("reference", "limits", "motors", "guess", "mesh", "solver", "tracking")
_MOTION = tuple(key for key in KEYS["motion"] if key != "kind")
# Names stand in titles of figures and in tables.
_LONGEST_NAME = 500
_EXTRAS = ("extra_costs", "extra_limits")
_MECHANISM = tuple(key for key in KEYS["mechanism"] if key != "model")


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Problem:
    """A planning problem that was checked as a whole: what it asks makes sense, and the mechanism reaches it.

    Made by `Problem.reach`, `.periodic`, `.track` or `.from_file`; varied by `replace` and `with_settings`. All builders
    take the same arguments, each as the tables of a problem file have them:

    Args:
        mechanism: from `load_mechanism`, or what that takes: a built-in name, a path, MJCF text.
        start_deg, goal_deg: hinges' angles [deg] by joint name, of the independent joints; dependent ones may be named too
            and are checked against the closed loop. `start_m`, `goal_m`: slides' positions [m].
        start_at, goal_at: in place of joints, where sites of the model are, by name [m] in the world's frame:
            {"foot": [x, y, z]}, or the coordinates that matter, {"foot": {"z": 0.2}}. The pose is found by inverse
            kinematics, the nearest to the start; the end of a reach may leave it open.
        start_speed_deg_s, goal_speed_deg_s: independent speeds [deg/s]; `..._m_s` [m/s] on slides. At rest by default.
        duration_s: a number of seconds, or "free", then within `min_duration_s` and `max_duration_s` where they are given.
        waypoints: tables in order, with `at_deg`, `at_m` or `at` (places of sites), `speed_deg_s`, `speed_m_s`, `time_s`,
            whichever are known.
        turns: whole turns by joint that a periodic motion goes on by in a period, {"O": 1}; their sign is the direction.
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
        extra_costs: a list of `ExtraCost`, running costs beside `minimize`; with {} there they are the whole objective.
        extra_limits: a list of `ExtraLimit`, limits on every instant.
        name: of the problem in messages, tables and files; by default the mechanism's with the kind of motion.

    Raises:
        LinkplanError: with one sentence, for anything that a problem file would be refused for, and where start, goal,
            waypoints or reference lie beyond the mechanism's reach.
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
        """Return the problem of going from a start to a goal; the arguments are those of `Problem`.

        Without `duration_s` the duration is free. By default the integral of squared efforts is least.
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
        """Return the problem of a motion that returns to its own first state; the arguments are those of `Problem`.

        It moves between `start_deg` and `goal_deg`, where it is after half the period, or by way of `waypoints`, or comes
        nearest to the `reference`, whose period is then its duration and whose distance is least by default. With `turns`
        hinges go on by whole turns in every period.
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
            path_or_name: a built-in name (`linkplan list` has them) or a path. Paths in a file are from its own folder, else
                the working folder.
            settings: values that stand in for the file's, by dotted key: {"motion.duration_s": 0.2}.

        Raises:
            LinkplanError: for anything in the file or the settings that cannot be used.
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
        """Return the problem as the tables of a problem file, a copy; extra costs and limits have no place in them."""
        return copy.deepcopy(self.planning.source)

    def to_toml(self) -> str:
        """Return the problem as the text of a problem file: `from_file` of it, written down, is the same problem.

        Extra costs and limits are Python and not in it: a comment in its first line names them.
        """
        return file_text(self.planning)

    def replace(self, **changes: object) -> Problem:
        """Return the problem with some of the builders' arguments in place of what they were; None takes one back.

        A table, such as `limits`, is replaced as a whole; `with_settings` changes single values in one. Beside the
        builders' arguments there are `payload`, `home_deg`, `home_m` and `independent`, of the mechanism.

        Raises:
            LinkplanError: for an unknown argument, or as the builders do.
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
        """Return the problem with single values of its tables set, by dotted key: {"limits.effort.act_O": [-80, 80]}.

        Raises:
            LinkplanError: for a key or value that a problem file would be refused for.
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
        lasts = "free" if motion.duration_s is None else f"{motion.duration_s:g} s"
        return f"Problem({self.name!r}: {motion.kind} of {self.mechanism.name!r}, {self.planning.objective.name}, {lasts})"


def _built(kind: str, mechanism: object, name: str | None, said: Mapping[str, object]) -> Problem:
    """Return the problem of a builder's arguments, whatever else is among what is said."""
    tables: dict[str, dict] = {"mechanism": {}, "motion": {"kind": kind}}
    loaded = _mechanism(mechanism)
    _fill(tables, {key: value for key, value in said.items() if value is not None})
    name = f"{loaded.name}-{kind}" if name is None else _name(name)
    return _checked(problem_from_tables(name, tables, None, loaded, **_given_extras(said)))


def _given_extras(said: Mapping[str, object]) -> dict:
    return {key: () if said[key] is None else said[key] for key in _EXTRAS if key in said}


def _checked(planning: PlanningProblem) -> Problem:
    start_pose_of(planning)  # refuses what is beyond reach
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
    """Return a table with values in place of what was there; without those that are None."""
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
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > _LONGEST_NAME:
        raise ProblemError(
            f"a problem's name is a word of at most {_LONGEST_NAME} characters that can be shown, got {name!r}"
        )
    return name
