"""An explored problem: its sliders, and the report of the plan at their values."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
from msgspec.structs import replace

from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import LinkplanError, ProblemError, choose
from linkplan.models.mechanism import Mechanism
from linkplan.models.parameters import Parameter, is_payload_s_weight
from linkplan.models.poses.along import RANGE_ROUNDING
from linkplan.models.poses.assembly import advance, steps_to
from linkplan.models.poses.period import turn_of
from linkplan.models.poses.reach import reach
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.settings import number
from linkplan.planner.search.replan import Replanner
from linkplan.studies.compare.compare import Comparison, compare
from linkplan.studies.compare.tracking_result import comparison_sections
from linkplan.studies.output.document import Animation, Report, Section
from linkplan.studies.output.plan_sections import plan_report, plan_sections, verdict_sentence
from linkplan.studies.output.report_file import report_of

# The objectives of the page, those that need neither a reference nor motors.
OBJECTIVES = ("effort", "time", "work")
# Writes the problem file of a problem and returns its path.
Save = Callable[[Problem], str]
# Sliders of duration, payload and parameters go from a quarter to four times the problem's value; those of gains go further.
_SLIDER_FACTOR, _GAIN_FACTOR = 4.0, 16.0
# The slider of a number that moves a pin and has no range extends by this share of the mechanism's size to both sides of its
# value.
_PIN_SHARE = 0.05
# Sliders end this share of their length before the pose at which the loop opens, where rounding decides if it closes.
_INSIDE_SHARE = 2e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Slider:
    """A number that the page varies: its key, label, unit, range and current value."""

    key: str
    label: str
    unit: str
    low: float
    high: float
    value: float


@dataclass(eq=False, kw_only=True)
class Session:
    """A problem with the planner that follows its sliders. Mutable: it keeps the last solution and the last problem.

    Requests of several threads wait for each other.
    """

    first: Problem
    tracker: str = "pd+ff"
    planner: Replanner = field(default_factory=Replanner)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        if self.first.motion.kind != "reach":
            raise ProblemError(
                f"explore needs a reach, a motion from a start to a goal, got a {self.first.motion.kind} motion"
            )
        self.current = self.first

    def controls(self) -> dict:
        """Return the sliders, objectives and trackers of the page, in JSON types."""
        chosen = self.first.to_dict().get("objective", {}).get("minimize", "effort")
        further = [chosen] if isinstance(chosen, str) and chosen not in OBJECTIVES else []
        sliders = [asdict(one) for one in self.sliders()]
        choices = {"objectives": [*OBJECTIVES, *further], "objective": chosen}
        return {"sliders": sliders, **choices, "trackers": TRACKERS, "tracker": self.tracker}

    def sliders(self) -> list[Slider]:
        """Return the sliders: those of the joints' start and goal, duration, efforts, payload, parameters, gains of PD."""
        problem = self.first
        motion = problem.to_dict()["motion"]
        found = []
        for end in ("start", "goal"):
            for column, joint in enumerate(problem.mechanism.independent_joints):
                value = motion.get(f"{end}_{joint.unit}", {}).get(joint.name)
                if value is not None:
                    low, high = _range(problem, end, column, float(value))
                    key = f"{end}_{joint.unit}.{joint.name}"
                    found.append(
                        Slider(key=key, label=f"{end} {joint.name}", unit=joint.unit, low=low, high=high, value=float(value))
                    )
        if isinstance(motion.get("duration_s"), int | float):
            found.append(_about("duration_s", "duration", "s", float(motion["duration_s"])))
        if np.isfinite(effort_bounds(problem)).any():
            found.append(Slider(key="effort_percent", label="effort limits", unit="%", low=10.0, high=100.0, value=100.0))
        named = [one for one in problem.mechanism.parameters if one.name in problem.to_dict().get("parameters", {})]
        if problem.mechanism.payload is not None and not any(is_payload_s_weight(one.name) for one in named):
            found.append(_about("payload_kg", "payload", "kg", problem.mechanism.payload.mass_kg))
        found += [slider for one in named if (slider := self._number(one)) is not None]
        joints, tracking = problem.mechanism.independent_joints, problem.tracking
        for place, name in enumerate(("kp", "kd")):  # one for all joints or one for each; none for a gain of zero
            given = getattr(tracking, name)
            units = {joint.name: joint.gain_units[place] for joint in joints}
            shared = next(iter(units.values())) if len(set(units.values())) == 1 else ""
            rows = [(name, name, shared, given)]
            if isinstance(given, Mapping):
                rows = [(f"{name}.{joint}", f"{name} {joint}", units[joint], value) for joint, value in given.items()]
            found += [_about(*row, _GAIN_FACTOR) for row in rows if row[-1] > 0]
        return found

    def _number(self, one: Parameter) -> Slider | None:
        """Return the slider of a parameter over its range, or about its value; None for a zero without a range."""
        key, given = f"parameters.{one.name}", self._table(one.name)
        if "range" in given:
            low, high = given["range"]
            return Slider(key=key, label=one.name, unit=one.unit, low=low, high=high, value=one.value)
        if one.moves_pins:
            half = _PIN_SHARE * (self.first.mechanism.extent_m if one.unit == "m" else 1.0)
            low, high = max(one.least, one.value - half), one.value + half
            return Slider(key=key, label=one.name, unit=one.unit, low=low, high=high, value=one.value)
        return _about(key, one.name, one.unit, one.value) if one.value > 0 else None

    def _table(self, name: str) -> dict:
        """Return the table of a named parameter in the problem's file."""
        given = self.first.to_dict()["parameters"][name]
        return given if isinstance(given, dict) else {"value": given}

    def problem_at(self, values: Mapping[str, object], objective: str | None) -> Problem:
        """Return the problem at values of the sliders by key.

        Raises:
            LinkplanError: for an unknown key, or values that do not form a valid problem, also beyond the sliders' ends.
        """
        known = {slider.key: slider for slider in self.sliders()}
        settings: dict[str, object] = {}
        for key, given in values.items():
            if key not in known:
                raise ProblemError(f"unknown slider '{key}'; sliders are {', '.join(known)}")
            settings |= self._setting(key, number(given, key, positive=key == "effort_percent"), known[key])
        if objective is not None:
            settings["objective.minimize"] = objective
        if objective == "time":
            settings["motion.duration_s"] = "free"
        return self.first.replace(settings)

    def described(self) -> Problem:
        """Return the last planned problem; if it differs from the first one, its description says so."""
        last = self.current
        if last == self.first:
            return last
        duration, goal = last.motion.duration_s, last.sections.objective.minimize or "effort"
        length = "in free time" if duration is None else f"in {duration:g} s"
        with_ = f" with {'least ' if goal in OBJECTIVES else 'the objective '}{goal}" if isinstance(goal, str) else ""
        text = f"a reach {length}{with_}, from exploring {self.first.name}"
        return self.current.replace(description=text)

    def changes(self) -> str:
        """Return the words on what the last planned problem changes in the first one: its keys and their values."""
        before, after = (dict(_values(one.to_dict())) for one in (self.first, self.current))
        keys = [key for key in sorted(before | after) if before.get(key) != after.get(key)]
        changed = [f"{key} = {_short(after[key])}" if key in after else f"without {key}" for key in keys]
        return ", ".join(changed) or "the problem as it was read"

    def _setting(self, key: str, value: float, slider: Slider) -> dict[str, object]:
        """Return the settings that a slider's value changes; none if the slider was not moved."""
        if value == slider.value and key in ("effort_percent", "payload_kg"):
            return {}
        if key == "effort_percent":
            pairs = zip(self.first.mechanism.actuators, self.first.limits.actuators_effort.tolist(), strict=True)
            return {f"limits.effort.{one.name}": [value / 100.0 * low, value / 100.0 * high] for one, (low, high) in pairs}
        if key == "payload_kg":
            payload = self.first.mechanism.payload
            return {"mechanism.payload": payload.scaled(value / payload.mass_kg).table()}
        kind, _, name = key.partition(".")
        if kind == "parameters":
            twice = name == "payload.mass" and isinstance(self.first.to_dict()["mechanism"].get("payload"), dict)
            also: dict[str, object] = {"mechanism.payload.mass_kg": value} if twice else {}
            return {} if value == slider.value else also | {key: self._table(name) | {"value": value}}
        if kind in ("kp", "kd"):
            return {f"tracking.{key}": value}
        end = key.partition("_")[0]
        if end not in ("start", "goal") or value == slider.value:
            return {f"motion.{key}": value}
        # The file may also have positions of dependent joints. They belong to the old value of the slider and are omitted.
        motion, joints = self.first.to_dict()["motion"], self.first.mechanism.independent_joints
        tables = {unit: motion.get(f"{end}_{unit}", {}) for unit in ("deg", "m")}
        own = {unit: {joint.name: of[joint.name] for joint in joints if joint.name in of} for unit, of in tables.items()}
        named: dict[str, object] = {f"motion.{end}_{unit}": own[unit] for unit in own if own[unit] != tables[unit]}
        return named | {f"motion.{key}": value}

    def report(self, values: Mapping[str, object], objective: str | None, tracker: str | None = None) -> tuple[Report, dict]:
        """Return the report at values of the sliders, and the verdict with the times that plan and tracking took [s].

        Args:
            values: by key of the sliders.
            objective: None for the problem's own.
            tracker: None for the session's own.

        Raises:
            LinkplanError: if the values do not form a valid problem, or the tracker is unknown.
        """
        tracker = self.tracker if tracker is None else choose("tracker", tracker, TRACKERS, ProblemError)
        with self.lock:
            problem, begun = self.problem_at(values, objective), time.monotonic()
            plan = self.planner.plan(problem)
            planned = time.monotonic() - begun
            self.current = problem
            document = _tracked(plan, tracker)
            said = {"passed": plan.passed, "message": plan.message, "plan_s": planned}
            return document, said | {"all_s": time.monotonic() - begun}


def _values(table: Mapping, above: str = "") -> Iterator[tuple[str, object]]:
    """Yield the dotted keys of tables with their values."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _values(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _short(value: object) -> str:
    """Return a value with six digits."""
    if isinstance(value, list | tuple):
        return f"[{', '.join(_short(one) for one in value)}]"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _tracked(plan: Plan, tracker: str) -> Report:
    """Return the report of a plan with its tracked run, or of the plan alone if it cannot be tracked."""
    if not plan.passed:
        return plan_report(plan)
    try:
        found: Comparison = compare(plan, None, asked=[tracker])
    except LinkplanError:
        return plan_report(plan)
    return explored_report(plan, found)


def _range(problem: Problem, end: str, column: int, value: float) -> tuple[float, float]:
    """Return the ends of a coordinate's slider: its reach, or without an end half a period or half a metre about its value.

    With several degrees of freedom, the reach is that of the pose at this end of the motion, with the other coordinates
    fixed.
    """
    mechanism = problem.mechanism
    joint = mechanism.independent_joints[column]
    half = 0.5 * joint.shown(turn_of(mechanism, column)) if joint.kind == "hinge" else 0.5
    low, high = joint.shown(joint.lower), joint.shown(joint.upper)
    if mechanism.dof == 1 and not (can := reach(mechanism)).turns_fully:
        low, high = (joint.shown(end.position) for end in (can.lower, can.upper))
    low, high = (low if np.isfinite(low) else value - half), (high if np.isfinite(high) else value + half)
    if mechanism.dof > 1 and (pose := _pose_at(problem, end)) is not None:
        low, high = (joint.shown(_closed_until(mechanism, pose, column, joint.read(far))) for far in (low, high))
    inside = _INSIDE_SHARE * (high - low)
    low += 0.0 if np.isclose(low, joint.shown(joint.lower)) else inside
    high -= 0.0 if np.isclose(high, joint.shown(joint.upper)) else inside
    return min(low, value), max(high, value)


def _pose_at(problem: Problem, end: str) -> np.ndarray | None:
    """Return the pose at the start or the goal of a motion; None for a goal that is out of reach."""
    start = problem.start_pose()
    if end == "start":
        return start
    pose, arrived = advance(problem.mechanism, start, np.asarray(problem.motion.goal))
    return pose if arrived else None


def _closed_until(mechanism: Mechanism, pose: np.ndarray, column: int, far: float) -> float:
    """Return the position nearest to `far` up to which the loops close within the ranges of all joints."""
    target = pose[mechanism.independent].copy()
    target[column] = far
    ranges = np.array([(joint.lower, joint.upper) for joint in mechanism.joints])
    last = pose
    for reached in steps_to(mechanism, pose, target):
        if np.any(reached < ranges[:, 0] - RANGE_ROUNDING) or np.any(reached > ranges[:, 1] + RANGE_ROUNDING):
            break
        last = reached
    return float(last[mechanism.independent[column]])


def _about(key: str, label: str, unit: str, value: float, factor: float = _SLIDER_FACTOR) -> Slider:
    return Slider(key=key, label=label, unit=unit, low=value / factor, high=value * factor, value=value)


def explored_report(plan: Plan, comparison: Comparison) -> Report:
    """Return the report of an explored plan: its tracked motion with the facts of the plan, then the plan's sections."""
    first, *rest = plan_sections(plan, verdict=False)
    moving, *tables = comparison_sections(comparison)[0].blocks
    blocks = [moving if isinstance(block, Animation) else block for block in first.blocks]
    tracked = Section(title="Tracking", blocks=tables, depth=2)
    title, verdict = f"Plan {plan.problem.name}", verdict_sentence(plan)
    return report_of(title, verdict, plan.passed, [replace(first, blocks=blocks), rest[0], tracked, *rest[1:]])
