"""The result of `track` and `compare` for a motion in phases: what each tracker's run on the ground does."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
from msgspec import Struct

from linkplan.controllers.phases.law import PhasedLaw
from linkplan.controllers.simulate import Ensemble
from linkplan.models.errors import PlanError, ProblemError
from linkplan.models.poses.along import sampled
from linkplan.models.poses.whole_body import centre_of_mass
from linkplan.planner.files.columns import csv_bytes, head_of, parquet_bytes
from linkplan.planner.files.structs import NOT_READ, Beside
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.plan.phased import PhasedRecord
from linkplan.studies.compare.compare import Mismatch
from linkplan.studies.compare.on_ground import GroundMotion, ground_motion, law_of, run_on_ground
from linkplan.studies.compare.user_tracker import TrackerLike
from linkplan.studies.output.animation import Run, animation, frames_of
from linkplan.studies.output.document import Block, Plot, Report, Section, Text, table_of
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result

# A smaller way of the centre of mass [m] is rounding.
_LEAST_WAY_M = 1e-9


class GroundLog(Struct, frozen=True, kw_only=True, eq=False):
    """A run at its control instants (t,).

    `pose` (t, n_q) [rad or m], `effort` (t, n_u) [N.m or N], the feet's `forces` (t, n_feet) [N], the number of the `phase`
    (t,), and the `centre` of mass (t, 3) [m].
    """

    time_s: np.ndarray
    pose: np.ndarray
    effort: np.ndarray
    forces: np.ndarray
    phase: np.ndarray
    centre: np.ndarray


class PhaseBegin(Struct, frozen=True, kw_only=True):
    """A phase of a run: when the plan has it begin, and when it began [s]; None if it did not."""

    name: str
    planned_s: float
    measured_s: float | None


class GroundRun(Struct, frozen=True, kw_only=True):
    """What a tracker does on the ground.

    Args:
        failure: why the run ended early; None if it did not.
        phases: when each began.
        on_time: whether each touch-down came within the time that the tracker waits for it.
        apex_m: the largest height of the centre of mass [m].
        distance_m: how far the centre of mass moves along x, until the planned end [m].
        slip_m: how far a foot slides while it should stand, at most [m].
        peak_force_n: the feet's largest normal force, averaged over a control period, by site [N].
        multiplier: the largest multiplier of a gait's errors over a repetition, by its Poincare map; None for others.
    """

    failure: str | None
    phases: tuple[PhaseBegin, ...]
    on_time: bool
    apex_m: float
    distance_m: float
    slip_m: float
    peak_force_n: dict[str, float]
    multiplier: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the run went through all phases in time."""
        return self.failure is None and self.on_time and all(one.measured_s is not None for one in self.phases)


class GroundTracking(Result, Struct, frozen=True, kw_only=True, eq=False, omit_defaults=True):
    """Trackers' runs on a motion in phases in MuJoCo, with real contacts on the ground.

    Args:
        plan: its problem's name.
        plan_passed: whether it is certified.
        apex_m: as planned [m].
        distance_m: as planned, over the repetitions of a gait that are simulated [m].
        repeats: whether it is a gait.
        case: the title of the runs.
        runs: by tracker.
        mismatch: that of the mismatched runs; None without.
        mismatched: likewise, with another mass and delay.
        tracker: that of `track`; None for several.
    """

    has_parquet = True

    plan: str
    plan_passed: bool
    apex_m: float
    distance_m: float
    repeats: bool
    case: str
    runs: dict[str, GroundRun]
    mismatch: str | None = None
    mismatched: dict[str, GroundRun] = {}
    tracker: str | None = None
    motion: Beside[GroundMotion] = NOT_READ
    logs: Beside[dict[str, GroundLog]] = NOT_READ  # by "nominal-TRACKER" and "mismatch-TRACKER"

    @property
    def record_name(self) -> str:
        """The name of the record: that of the command."""
        return "compare" if self.tracker is None else "track"

    @property
    def passed(self) -> bool:
        """Whether the plan passes, and every run goes through all phases in time."""
        return self.plan_passed and all(run.passed for _, runs in self._cases for run in runs.values())

    def blocks(self) -> list[Block]:
        """Return the tables of the runs."""
        goal, planned = ("distance", self.distance_m) if self.repeats else ("apex", self.apex_m)
        found: list[Block] = [Text(text=f"{self.plan} on the ground: {goal} {planned:.6g} m as planned")]
        for title, runs in self._cases:
            heads = ["tracker", f"{goal} [m]", "of the planned", "largest slip [m]", "largest force [N]"]
            rows = []
            for name, run in runs.items():
                reached = run.distance_m if self.repeats else run.apex_m
                share = f"{100 * reached / planned:.4g} %" if planned else ""
                row = [name, reached, share, run.slip_m, max(run.peak_force_n.values(), default=0.0)]
                rows.append([*row, run.multiplier] if self.repeats else row)
            heads += ["multiplier of errors"] if self.repeats else []
            found.append(table_of(f"Runs, {title}", heads, rows, digits=5))
            phases = zip(*(run.phases for run in runs.values()), strict=True)
            begun = [(each[0].name, each[0].planned_s, *(one.measured_s for one in each)) for each in phases]
            heads = ["phase", "as planned [s]", *(f"{name} [s]" for name in runs)]
            found.append(table_of(f"Beginnings of the phases, {title}", heads, begun, digits=6))
            lost = [(name, run) for name, run in runs.items() if not run.passed]
            words = "a touch-down does not come in time: it falls, or has another gait"
            found += [Text(text=f"{name}: {run.failure or words}", tone="bad") for name, run in lost]
        return found

    @property
    def _cases(self) -> list[tuple[str, dict[str, GroundRun]]]:
        """The runs with the title of each case."""
        mismatched = [] if self.mismatch is None else [(self.mismatch, self.mismatched)]
        return [(self.case, self.runs), *mismatched]

    def document(self) -> Report:
        """Return the report: the runs, their motion and forces."""
        well, lost = ([name for name, run in self.runs.items() if run.passed is is_so] for is_so in (True, False))
        verdict = f"{self.case}: all phases in time with {', '.join(well) or 'no tracker'}"
        verdict += f", NOT with {', '.join(lost)}" if lost and well else ""
        sections = [Section(title="On the ground", blocks=[*self.blocks(), self._animation(), *self._plots()])]
        return report_of(f"Trackers on {self.plan}", verdict, bool(well), sections)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the figure of the centre of mass, the joints and the forces."""
        yield self.record_name, FigureSpec(panels=list(self._plots()), title=f"{self.plan} on the ground", columns=2)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write every run's time series."""
        for name, log in self.logs.items():
            stem = "".join(letter if letter.isalnum() or letter in "+-_" else "_" for letter in name)
            columns = self._columns(log)
            (place / f"{stem}.csv").write_bytes(csv_bytes(columns))
            if parquet:
                (place / f"{stem}.parquet").write_bytes(parquet_bytes(columns, {"plan": self.plan, "tracker": name}))

    def _columns(self, log: GroundLog) -> dict[str, np.ndarray]:
        mechanism, found = self.motion.mechanism, {"time_s": log.time_s}
        for k, joint in enumerate(mechanism.joints):
            found[head_of(f"{joint.name}_ref", joint.unit)] = joint.shown(self.motion.whole.pose_rad[: len(log.time_s), k])
            found[head_of(joint.name, joint.unit)] = joint.shown(log.pose[:, k])
        for k, actuator in enumerate(mechanism.actuators):
            found[head_of(f"{actuator.name}_applied", actuator.unit)] = log.effort[:, k]
        forces = {head_of(f"{foot.site} force", "N"): log.forces[:, k] for k, foot in enumerate(self.motion.feet)}
        centre = {head_of(f"com_{axis}", "m"): log.centre[:, k] for k, axis in enumerate("xyz")}
        return found | forces | centre | {"phase": log.phase}

    def _plots(self) -> Iterator[Plot]:
        """Yield the place of the centre of mass, the force on each foot and the effort of each actuator, with all runs."""
        whole, mechanism = self.motion.whole, self.motion.mechanism
        longest = max(self.logs.values(), key=lambda log: len(log.time_s)).time_s
        planned = sampled(centre_of_mass(mechanism), whole.pose_rad)[:, :, 0]

        def lines(of: Callable[[GroundLog], np.ndarray], unit: str) -> list[Line]:
            return [_line(name, of(log), longest, unit) for name, log in self.logs.items()]

        for axis, k in (("x", 0), ("z", 2)):
            moves = max(np.ptp(log.centre[:, k]) for log in self.logs.values()) > _LEAST_WAY_M
            shown = [] if self._past_end(k) else [_line("planned", planned[:, k], longest, "m")]
            shown = [*shown, *lines(lambda log, k=k: log.centre[:, k], "m")] if moves else []
            yield from plots(f"Centre of mass, {axis}", "place", TIME, longest, shown, group=self.plan)
        for k, foot in enumerate(self.motion.feet):
            shown = lines(lambda log, k=k: log.forces[:, k], "N")
            yield from plots(f"Normal force on {foot.site}", "force", TIME, longest, shown, group=self.plan)
        for k, actuator in enumerate(mechanism.actuators):
            shown = lines(lambda log, k=k: log.effort[:, k], actuator.unit)
            yield from plots(f"Effort of {actuator.name}", "effort", TIME, longest, shown, group=self.plan)

    def _past_end(self, axis: int) -> bool:
        """Whether the motion ends in flight and `axis` is the height, which the plan does not have afterwards."""
        return axis == 2 and not self.repeats and not self.motion.record.phases[-1].on

    def _animation(self) -> Block:
        """Return the animation of the planned motion, until its end, with every run as a ghost."""
        motion, runs, whole = self.motion, {}, self.motion.whole
        last = whole.n - 1 if self.repeats else min(whole.n, sum(one.n for one in motion.references)) - 1
        frames = np.unique(np.linspace(0, last, frames_of(motion.mechanism, 1 + len(self.logs))).astype(int))
        for name, log in self.logs.items():
            at = np.minimum(frames, len(log.time_s) - 1)
            runs[name] = Run(poses=np.nan_to_num(log.pose[at]), effort=np.nan_to_num(log.effort[at]))
        return animation(
            motion.mechanism,
            f"{self.plan}, planned and as tracked on the ground",
            self.plan,
            whole.time_s[frames],
            whole.pose_rad[frames],
            effort=whole.effort[frames],
            effort_limit=effort_bounds(motion.plans[0].problem),
            ghosts=runs,
            sites=motion.plans[0].problem.sites,
        )

    def __repr__(self) -> str:
        return f"GroundTracking({self.plan!r}: {', '.join(self.runs)})"


def _line(name: str, values: np.ndarray, longest: np.ndarray, unit: str) -> Line:
    """Return values over the longest run's time; not numbers after the end of a shorter run."""
    found = np.full(len(longest), np.nan)
    n = min(len(values), len(longest))
    found[:n] = values[:n]
    return Line(name=name, values=found, unit=unit)


def ground_log(motion: GroundMotion, law: PhasedLaw, ensemble: Ensemble) -> GroundLog:
    """Return the log of an ensemble's only machine on the ground."""
    kept, n_q = slice(0, max(1, int(ensemble.done[0]))), motion.mechanism.n_q
    pose, forces = ensemble.pose[kept, 0], ensemble.velocity[kept, 0, n_q:]
    return GroundLog(
        time_s=ensemble.time_s[kept, 0],
        pose=pose,
        effort=ensemble.applied[kept, 0],
        forces=forces,
        phase=law.phases_of(forces)[0],
        centre=sampled(centre_of_mass(motion.mechanism), pose)[:, :, 0],
    )


def ground_run(
    motion: GroundMotion, law: PhasedLaw, log: GroundLog, failure: str | None, multipliers: np.ndarray | None
) -> GroundRun:
    """Return what a run does."""
    names, n = [phase.name for phase in motion.record.phases], len(motion.record.phases)
    total, last, begins = float(motion.record.duration_s or 0.0), float(motion.whole.time_s[-1]), []
    repetitions = 1 if motion.exchanged is None else int(np.ceil(last / total))
    planned = total * np.arange(repetitions)[:, None] + [phase.begins_s for phase in motion.record.phases]
    for number, at in enumerate(planned[planned < last]):
        seen = np.flatnonzero(log.phase >= number)
        measured = float(log.time_s[seen[0]]) if len(seen) else None
        begins.append(PhaseBegin(name=names[number % n], planned_s=float(at), measured_s=measured))
    lengths = np.bincount(log.phase)[:-1]  # of the phases that have ended
    at_end = len(log.centre) - 1
    if motion.exchanged is None:
        at_end = min(at_end, round(total / motion.whole.period_s))
    return GroundRun(
        failure=failure,
        phases=tuple(begins),
        on_time=all(law.stages[number % n].in_time(int(length)) for number, length in enumerate(lengths)),
        apex_m=float(log.centre[:, 2].max()),
        distance_m=float(log.centre[at_end, 0] - log.centre[0, 0]),
        slip_m=_slip(motion, law, log),
        peak_force_n={foot.site: float(log.forces[:, k].max()) for k, foot in enumerate(motion.feet)},
        multiplier=None if multipliers is None else float(np.abs(multipliers).max()),
    )


def _slip(motion: GroundMotion, law: PhasedLaw, log: GroundLog) -> float:
    """Return how far a foot slides along the ground while it stands in a phase and pushes [m]."""
    model, data = motion.mechanism.model, mujoco.MjData(motion.mechanism.model)
    places = np.empty((len(log.pose), len(motion.feet), 3))
    for t, qpos in enumerate(motion.mechanism.qpos_of(log.pose)):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for k, foot in enumerate(motion.feet):
            body = model.body(foot.body).id
            places[t, k] = data.xpos[body] + data.xmat[body].reshape(3, 3) @ foot.place
    largest = 0.0
    for number in np.unique(log.phase):
        on = law.on_in(int(number), motion.on[number % len(motion.on)])
        for k in np.flatnonzero(on):
            stands = places[(log.phase == number) & (log.forces[:, k] > 0), k]
            normal = motion.feet[k].ground[3:]
            along = stands - np.outer(stands @ normal, normal)
            largest = max(largest, float(np.linalg.norm(along - along[:1], axis=1).max(initial=0.0)))
    return largest


def ground_tracking(
    record: PhasedRecord,
    asked: Sequence[TrackerLike],
    mismatch: Mismatch | None,
    say: Callable[[str], None],
    *,
    alone: bool,
) -> GroundTracking:
    """Return trackers' runs on a plan in phases: that of `track` (`alone`), or nominal ones and those with a mismatch.

    Raises:
        LinkplanError: if the plan has no motion, its phases change more than contacts, or a tracker is invalid.
    """
    if not record.plans or any(plan.trajectory is None for plan in record.plans):
        raise PlanError(f"there is no motion to track: {record.message}", record)
    motion, logs = ground_motion(record), {}
    laws = {}
    for tracker in asked:
        law, multipliers = law_of(tracker, motion)
        if law.name in laws:
            raise ProblemError(f"a comparison needs trackers with different names, got {law.name} twice")
        laws[law.name] = law, multipliers

    def runs(case: Mismatch | None) -> dict[str, GroundRun]:
        found = {}
        for name, (law, multipliers) in laws.items():
            say(f"{name}, {'nominal' if case is None else case.name}: {motion.whole.n} control periods on the ground")
            ensemble = run_on_ground(motion, law, case)
            log = ground_log(motion, law, ensemble)
            logs[f"{'nominal' if case is None else 'mismatch'}-{name}"] = log
            found[name] = ground_run(motion, law, log, ensemble.failure[0], multipliers)
        return found

    first = mismatch if alone else None
    second = None if alone else mismatch
    centre = sampled(centre_of_mass(motion.mechanism), motion.whole.pose_rad[[0, -1]])[:, 0, 0]
    return GroundTracking(
        plan=record.problem,
        plan_passed=record.passed,
        apex_m=record.body.apex_m if record.body else float("nan"),
        distance_m=float(centre[1] - centre[0]),
        repeats=motion.exchanged is not None,
        case="nominal" if first is None else first.name,
        runs=runs(first),
        mismatch=None if second is None else second.name,
        mismatched={} if second is None else runs(second),
        tracker=next(iter(laws)) if alone else None,
        motion=motion,
        logs=logs,
    )
