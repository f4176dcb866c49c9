"""The answer to a planning problem: a motion with its certificate, or the reason why there is none.

A motion is given at any times in the units of files: positions and speeds of all joints, efforts, sites, bodies' angles.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from msgspec import structs

from linkplan.models.deadline import NO_DEADLINE, Deadline
from linkplan.models.errors import LinkplanError, PlanError, ProblemError
from linkplan.models.extras import load_extra
from linkplan.models.poses.along import accelerations, jerks, joint_rates, sampled, site_motion, whole_turns
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.inverse_kinematics import places_of
from linkplan.models.poses.joint_forces import JointForces, joint_forces
from linkplan.models.tree.joints import shown_by_name
from linkplan.planner.certificate.certificate import Certificate
from linkplan.planner.certificate.demands import Demand, demands_of
from linkplan.planner.certificate.further_checks import contact_notes
from linkplan.planner.files.columns import head_of
from linkplan.planner.plan.verdict import Kind, Overrun, Verdict, failed
from linkplan.planner.problem.problem import Problem
from linkplan.planner.problem.sites import AXES, angles_of
from linkplan.planner.proof.finding import Proof
from linkplan.planner.refinement.history import Step
from linkplan.planner.trajectory import Trajectory
from linkplan.planner.transcription.collocation import Transcribed


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class MotionTable:
    """A motion at times (n,) [s]: by joint in degrees, or m for slides; by actuator [N.m or N]; by site (n, 3) [m].

    `unit` is the unit of positions by joint, `effort_unit` the unit by actuator. `site` are the places of the sites that the
    problem names, in the world's frame, with their derivatives by time, and `body_deg` the angles of the bodies that it
    names. Jerks are those within the intervals: where efforts jump, they are infinite. `states` are the arguments of
    `joint_forces`.
    """

    time_s: np.ndarray
    position_deg: dict[str, np.ndarray]
    speed_deg_s: dict[str, np.ndarray]
    acceleration_deg_s2: dict[str, np.ndarray]
    jerk_deg_s3: dict[str, np.ndarray]
    effort: dict[str, np.ndarray]
    unit: dict[str, str]
    effort_unit: dict[str, str]
    site: dict[str, np.ndarray]
    site_speed_m_s: dict[str, np.ndarray]
    site_acceleration_m_s2: dict[str, np.ndarray]
    site_jerk_m_s3: dict[str, np.ndarray]
    body_deg: dict[str, np.ndarray]
    states: tuple

    @property
    def joint_forces(self) -> JointForces:
        """The forces [N] and moments [N.m] in all closures and joints, and on the frame, at all times."""
        return joint_forces(*self.states)

    def __repr__(self) -> str:
        time = np.atleast_1d(self.time_s)
        ends = (
            f"{time.min():.6g} s" if time.size == 1 else f"{time.size} instants from {time.min():.6g} to {time.max():.6g} s"
        )
        names = {"joints": self.position_deg, "actuators": self.effort, "sites": self.site, "bodies": self.body_deg}
        parts = "; ".join(f"{word} {', '.join(found)}" for word, found in names.items() if found)
        return f"MotionTable({ends}: {parts})"

    def single(self) -> MotionTable:
        """Return the first row, with numbers instead of arrays."""
        tables = {
            one.name: getattr(self, one.name) for one in fields(self) if one.name not in ("unit", "effort_unit", "states")
        }
        time = float(tables.pop("time_s")[0])
        first = {
            key: {name: x[0] if x.ndim > 1 else float(x[0]) for name, x in table.items()} for key, table in tables.items()
        }
        return replace(self, time_s=time, **first)

    def by_quantity(self) -> dict[str, dict[str, tuple[str, np.ndarray]]]:
        """Return the unit and the values by name of the motion of joints and sites, of efforts and of angles of bodies."""

        def rates(values: dict[str, np.ndarray], per: str) -> dict[str, tuple[str, np.ndarray]]:
            return {name: (self.unit[name] + per, x) for name, x in values.items()}

        return {
            "position": rates(self.position_deg, ""),
            "speed": rates(self.speed_deg_s, "/s"),
            "acceleration": rates(self.acceleration_deg_s2, "/s2"),
            "jerk": rates(self.jerk_deg_s3, "/s3"),
            "effort": {name: (self.effort_unit[name], x) for name, x in self.effort.items()},
            "site": {name: ("m", x) for name, x in self.site.items()},
            "site_speed": {name: ("m/s", x) for name, x in self.site_speed_m_s.items()},
            "site_acceleration": {name: ("m/s2", x) for name, x in self.site_acceleration_m_s2.items()},
            "site_jerk": {name: ("m/s3", x) for name, x in self.site_jerk_m_s3.items()},
            "body": {name: ("deg", x) for name, x in self.body_deg.items()},
        }

    def columns(self) -> dict[str, np.ndarray]:
        """Return all columns (n,), units in their heads: time_s, O_deg, O_deg_s, ..., act_O_Nm, foot_x_m, body_shank_deg.

        The forces in joints and on the frame are O_force_N, frame_force_x_N, ..., O_moment_Nm, frame_moment_x_Nm.
        """
        of = self.by_quantity()
        rows = [(name, *of[key][name]) for name in self.position_deg for key in ("position", "speed")]
        rows += [(name, *row) for key in ("acceleration", "jerk", "effort") for name, row in of[key].items()]
        found = {"time_s": self.time_s} | {head_of(name, unit): values for name, unit, values in rows}
        found |= {f"pin_{head}" if head in found else head: values for head, values in self._force_columns()}
        for name in self.site:
            quantities = [of[key][name] for key in ("site", "site_speed", "site_acceleration", "site_jerk")]
            columns = {
                head_of(f"{name}_{axis}", unit): values[:, k] for unit, values in quantities for k, axis in enumerate(AXES)
            }
            taken = not found.keys().isdisjoint(columns)  # by a slide of that name
            found |= {f"site_{head}" if taken else head: values for head, values in columns.items()}
        for name, angle in self.body_deg.items():
            head = f"body_{name}_deg"
            found[f"body_{head}" if head in found else head] = angle  # a hinge of that name has this head
        return found

    def _force_columns(self) -> Iterator[tuple[str, np.ndarray]]:
        """Yield the heads and values (n,) of the forces and moments in joints and on the frame."""
        loads = self.joint_forces
        for first, what, unit, sizes in ((0, "force", "N", loads.force), (3, "moment", "N.m", loads.moment)):
            yield from ((head_of(f"{name}_{what}", unit), values) for name, values in sizes.items())
            for k, axis in enumerate(AXES):
                yield head_of(f"frame_{what}_{axis}", unit), loads.on_frame[:, first + k]

    def named_arrays(self) -> tuple[dict, dict]:
        """Return the variables and coordinates of a data set, each as the names of its dimensions and its values."""
        joints, actuators = list(self.position_deg), list(self.effort)
        by_joint: dict[str, tuple[tuple[str, ...], np.ndarray]] = {
            key: (("time_s", "joint"), np.column_stack([getattr(self, key)[name] for name in joints]))
            for key in ("position_deg", "speed_deg_s", "acceleration_deg_s2", "jerk_deg_s3")
        }
        variables: dict[str, tuple[tuple[str, ...], np.ndarray]] = by_joint | {
            "effort": (("time_s", "actuator"), np.column_stack([self.effort[name] for name in actuators])),
        }
        coordinates = {
            "time_s": self.time_s,
            "joint": joints,
            "joint_unit": ("joint", [self.unit[name] for name in joints]),
            "actuator": actuators,
            "actuator_unit": ("actuator", [self.effort_unit[name] for name in actuators]),
        }
        if self.site:
            for key in ("site", "site_speed_m_s", "site_acceleration_m_s2", "site_jerk_m_s3"):
                variables[key] = (("time_s", "site_name", "axis"), np.stack(list(getattr(self, key).values()), axis=1))
            coordinates |= {"site_name": list(self.site), "axis": list(AXES)}
        if self.body_deg:
            variables["body_deg"] = (("time_s", "body"), np.column_stack(list(self.body_deg.values())))
            coordinates["body"] = list(self.body_deg)
        return variables, coordinates


def asked_times(time_s: object, end_s: float = np.inf) -> np.ndarray:
    """Return times [s], (n,) or a single one (); refuse values that are not finite numbers from 0 to a motion's end."""
    try:
        time = np.asarray(time_s, dtype=float)
    except (TypeError, ValueError, OverflowError):
        time = np.full((), np.nan)
    if time.ndim > 1 or not np.all(np.isfinite(time)):
        raise ProblemError(f"times must be finite numbers of seconds, one or a row of them, got {time_s!r}")
    if np.isfinite(end_s) and np.any(np.abs(2 * time - end_s) > end_s * (1 + 1e-9)):
        raise ProblemError(f"times must be from 0 to {end_s:.7g} s, where the motion ends, got {time_s!r}")
    return time


def sample_motion(problem: Problem, trajectory: Trajectory, time_s: object = None, *, jumps: bool = False) -> MotionTable:
    """Return a motion at times (n,) [s], or at a single time as numbers; otherwise as `motion_table`.

    Raises:
        ProblemError: for times that are not finite numbers, or beyond the ends of a motion that is not periodic.
        AssemblyError: when the loops do not close along the motion.
    """
    end_s = np.inf if trajectory.periodic else trajectory.duration_s
    time = None if time_s is None else asked_times(time_s, end_s)
    table = motion_table(problem, trajectory, None if time is None else np.atleast_1d(time), jumps=jumps)
    return table.single() if time is not None and time.ndim == 0 else table


def motion_table(
    problem: Problem, trajectory: Trajectory, time_s: np.ndarray | None = None, *, jumps: bool = False
) -> MotionTable:
    """Return a motion at times (n,) [s], in any order; by default at ten times per interval.

    The default times increase strictly, and a break between intervals has the later interval's values. With `jumps` it
    appears twice, just before and at the break, to show jumps of efforts.

    Beyond its ends a periodic motion is continued, with its turns. Any other motion rests there under the effort of the
    nearer end.

    Raises:
        AssemblyError: when the loops do not close along the motion.
    """
    mechanism = problem.mechanism
    dense = trajectory.dense_times()  # near enough to follow the loops from sample to sample
    time = (dense if jumps else _single_valued(dense)) if time_s is None else np.asarray(time_s, dtype=float)
    # Loops are followed along the whole motion, so the order and distance of the given times do not matter.
    along, back = np.unique(np.concatenate([dense, trajectory.times_within(time)]), return_inverse=True)
    poses = follow(mechanism, trajectory.position_at(along), trajectory.start_pose)
    gone = whole_turns(mechanism, poses[-1] - poses[0]) if np.any(trajectory.advance) else np.zeros(mechanism.n_q)
    q = poses[back[len(dense) :]] + trajectory.periods_at(time)[:, None] * gone
    v, a, jerk = (of(time) for of in (trajectory.velocity_at, trajectory.acceleration_at, trajectory.jerk_at))
    efforts = trajectory.effort_at(time)

    def of_sites(order: int) -> dict[str, np.ndarray]:
        motion = (q, v, a, jerk)[: max(3, order + 1)]
        values = sampled(site_motion(mechanism, order), *motion) if problem.sites else np.empty((len(q), 3, 0))
        return {name: values[:, :, index] for name, index in problem.sites.items()}

    return MotionTable(
        time_s=time,
        position_deg=shown_by_name(mechanism.joints, q),
        speed_deg_s=shown_by_name(mechanism.joints, joint_rates(mechanism, q, v)),
        acceleration_deg_s2=shown_by_name(mechanism.joints, accelerations(mechanism, q, v, a)),
        jerk_deg_s3=shown_by_name(mechanism.joints, jerks(mechanism, q, v, a, jerk)),
        effort={actuator.name: u for actuator, u in zip(mechanism.actuators, efforts.T, strict=True)},
        unit={joint.name: joint.unit for joint in mechanism.joints},
        effort_unit={actuator.name: actuator.unit for actuator in mechanism.actuators},
        site={name: places_of(mechanism, index, q) for name, index in problem.sites.items()},
        site_speed_m_s=of_sites(1),
        site_acceleration_m_s2=of_sites(2),
        site_jerk_m_s3=of_sites(3),
        body_deg={name: np.degrees(angles_of(mechanism, index, q)) for name, index in problem.bodies.items()},
        states=(mechanism, q, v, a, efforts, *mechanism.forces_at(time)),
    )


def _single_valued(dense: np.ndarray) -> np.ndarray:
    """Return increasing times (n,) without near duplicates; of two close times, the later stays."""
    tie_break_s = 1e-9 * (dense[-1] - dense[0])  # twelve digits in a table still distinguish them
    kept = [float(dense[-1])]
    for time in dense[-2::-1]:
        if kept[-1] - time > tie_break_s:
            kept.append(float(time))
    return np.array(kept[::-1])


if TYPE_CHECKING:
    import pandas  # pyright: ignore[reportMissingImports]
    import xarray


@dataclass(frozen=True, eq=False, slots=True, kw_only=True, repr=False)
class Plan:
    """A motion with its certificate, or the reason why there is none. Times are in seconds from the motion's start.

    `details` holds further values by name, with the unit in the name. `solved` is the last program with its solution as the
    starting point, for warm starts; None for a motion that needed no solver. `solved_again` says that it was solved by a
    warm start of an existing program. `read_scheme` is the transcription of a motion that has no program here, as that of a
    plan that was read.
    """

    problem: Problem
    verdict: Verdict
    """What was found and by what it is known, as data: the kind, the limits that are exceeded, what would do."""
    objective: float | None = None
    """The value of the objective in SI units: effort [N2 m2 s], time [s], tracking [rad2 s], ...; None if unknown.

    A plan that failed has none, even if it has a motion: that motion does not keep the problem's limits.
    """
    trajectory: Trajectory | None = None
    certificate: Certificate | None = None
    """The checks between the nodes: `passed`, `failures` and all values, in SI units; None without a motion."""
    proof: Proof | None = None
    """The claims that are proved, refuted or undecided at every instant of the motion; None before it is proved."""
    history: tuple[Step, ...] = ()
    """The solves before this plan, in order, each with its settings and its result."""
    details: dict[str, float] = field(default_factory=dict)
    solved: Transcribed | None = None
    solved_again: bool = False
    read_scheme: str | None = None

    def __reduce__(self) -> tuple:
        """Pickle without the program, which a saved plan does not have either."""
        kept = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "solved"}
        return _unpickled, (type(self), kept | {"read_scheme": self.scheme})

    def adding(self, *further: str, **changes: Any) -> Self:
        """Return this plan with further phrases in its verdict, and with changes of the verdict."""
        return replace(self, verdict=self.verdict.adding(*further, **changes))

    @property
    def status(self) -> Kind:
        """The kind of the verdict: "optimal" (converged and certified), "feasible" (certified), "infeasible" or "failed".

        A feasible motion may not be locally optimal; `message` has the reason.
        """
        return self.verdict.kind

    @property
    def message(self) -> str:
        """The verdict in a sentence; without a motion, it names the limit, the joint, the instant and the excess."""
        return self.verdict.sentence

    @property
    def passed(self) -> bool:
        """Whether it has a motion that passes its certificate, optimal or not."""
        return self.verdict.passed

    def require(self) -> Self:
        """Return this plan if its motion is certified (optimal or feasible).

        Raises:
            PlanError: otherwise: a `LinkplanError` with the message, with the plan as `.plan` and its `.verdict`.
        """
        if not self.passed:
            raise PlanError(self.message, self)
        return self

    def require_motion(self, use: str) -> Trajectory:
        """Return the trajectory for `use` (a verb).

        Raises:
            LinkplanError: if the plan has no motion.
        """
        if self.trajectory is None:
            raise LinkplanError(f"cannot {use}: the plan has no motion: {self.message}")
        return self.trajectory

    def prove(self, *, existence: bool = True) -> Proof:
        """Return the proof of the motion's limits at every instant, from the coefficients of its polynomials alone.

        Ball arithmetic encloses the closure and the efforts by inverse dynamics between all samples. The proof's
        `of(answer)` returns the `proved`, `refuted`, `undecided` or `sampled` findings; `passed` is true if nothing is
        refuted, `complete` if everything is proved.

        Args:
            existence: whether a motion of the model near the plan is looked for, too, for at most a minute.

        Raises:
            LinkplanError: if the plan has no motion.
        """
        return self._proved(NO_DEADLINE, existence=existence)

    def with_proof(self, until: Deadline = NO_DEADLINE, *, existence: bool = True) -> Self:
        """Return this plan with its proof; its status is "failed" if the proof refutes a limit.

        Args:
            until: the deadline.
            existence: whether a motion of the model near the plan is looked for, too, for at most a minute.

        Raises:
            LinkplanError: if the plan has no motion.
            OutOfTimeError: if the deadline passes before all claims are decided, or is predicted to do so.
        """
        proof = self._proved(until, existence=existence)
        if proof.passed or not self.passed or self.certificate is None:
            return replace(self, proof=proof)
        refuted = tuple(f"the proof refutes: {finding.sentence()}" for finding in proof.of("refuted"))
        certificate = structs.replace(self.certificate, failures=refuted)
        words = f"the motion does not pass its certificate between the samples: {'; '.join(refuted)}"
        overruns = tuple(Overrun.of_finding(one) for one in proof.of("refuted") if one.limit)
        verdict = failed(words, "certificate", known_by="proof", overruns=overruns)
        return replace(self, proof=proof, verdict=verdict, objective=None, certificate=certificate)

    def _proved(self, until: Deadline, *, existence: bool) -> Proof:
        from linkplan.planner.proof.prove import prove

        trajectory = self.require_motion("prove")
        failures = (self.message,) if self.certificate is None else self.certificate.failures
        return prove(self.problem, trajectory, failures, until, existence=existence)

    @property
    def duration_s(self) -> float | None:
        """The duration of the motion [s]; None without a motion that passes its certificate."""
        return self.trajectory.duration_s if self.trajectory is not None and self.passed else None

    @property
    def scheme(self) -> str:
        """The transcription of the final mesh; the problem's if nothing was solved."""
        return (self.read_scheme or self.problem.mesh.scheme) if self.solved is None else self.solved.scheme.name

    @property
    def intervals(self) -> int:
        """The number of intervals of the final mesh; the problem's if there is no motion."""
        if self.trajectory is None:
            return self.problem.mesh.intervals
        return len(self.trajectory.breaks_s) - 1

    def sample(self, time_s: float | np.ndarray | None = None, *, jumps: bool = False) -> MotionTable:
        """Return the motion at times: positions and their derivatives by joint and site, `effort` by actuator.

        Args:
            time_s: a time or times (n,) [s], in any order; by default ten instants of every interval. A periodic motion
                continues beyond its ends.
            jumps: whether the default times have both sides of a jump in effort, at equal times; else they increase.

        Returns:
            `time_s`; `position_deg` [deg, or m of slides], `speed_deg_s`, `acceleration_deg_s2` and `jerk_deg_s3` of all
            joints by name; `effort` [N.m or N] by actuator: arrays (n,), or numbers for a single time. `unit` and
            `effort_unit` are their units. `site` has the sites that the problem names, (n, 3) or (3,) [m] in the world
            frame, `site_speed_m_s`, `site_acceleration_m_s2` and `site_jerk_m_s3` its derivatives, and `body_deg` the angles
            of the bodies that it names. `joint_forces` are the forces and moments in all joints and on the frame.
            `columns()` returns all columns under heads with units.

        Raises:
            LinkplanError: if the plan has no motion, or a time is not finite or beyond its ends.
        """
        return sample_motion(self.problem, self.require_motion("sample"), time_s, jumps=jumps)

    def demands(self) -> tuple[Demand, ...]:
        """Return the motion's demands on each actuator: peak and rms effort, peak speed, powers and energy.

        Raises:
            LinkplanError: if the plan has no motion, or its loops cannot close along it.
        """
        return demands_of(self.problem, self.require_motion("judge actuators by"))

    def to_frame(self, time_s: np.ndarray | None = None) -> pandas.DataFrame:
        """Return the motion at times (n,) [s] as a pandas table, with a row for each time and units in the columns' names.

        Raises:
            MissingPackageError: if pandas is not installed.
            LinkplanError: as for `sample`.
        """
        table = self.sample(None if time_s is None else np.atleast_1d(time_s))
        return load_extra("pandas", "Plan.to_frame").DataFrame(table.columns())

    def to_dataset(self, time_s: np.ndarray | None = None) -> xarray.Dataset:
        """Return the motion at times (n,) [s] as an xarray data set over time.

        `position_deg`, `speed_deg_s`, `acceleration_deg_s2` and `jerk_deg_s3` (with m of slides) have the dimensions
        `time_s` and `joint`, `effort` [N.m or N] has `time_s` and `actuator`; the coordinates `joint_unit` and
        `actuator_unit` have their units. `site` [m] and its derivatives have `time_s`, `site_name` and `axis`, if the
        problem names sites; `body_deg` has `time_s` and `body`.

        Raises:
            MissingPackageError: if xarray is not installed.
            LinkplanError: as for `sample`.
        """
        table = self.sample(None if time_s is None else np.atleast_1d(time_s))
        return load_extra("xarray", "Plan.to_dataset").Dataset(*table.named_arrays())

    def __repr__(self) -> str:
        duration = "no motion" if self.duration_s is None else f"{self.duration_s:.6g} s"
        return f"Plan({self.problem.name!r}, {self.status}, {duration})"


def _unpickled(kind: type[Plan], kept: dict) -> Plan:
    return kind(**kept)


def not_honoured(plan: Plan) -> tuple[str, ...]:
    """Return phrases on what a plan neglects: the problem's list, and contacts along the motion."""
    contacts = () if plan.certificate is None else plan.certificate.contacts
    return (*plan.problem.not_honoured, *contact_notes(contacts))


def tracking_errors(plan: Plan) -> tuple[float, float] | None:
    """Return the rms and largest distance [rad or m] of a plan from its reference, or None without one."""
    trajectory = plan.trajectory
    reference = None if trajectory is None else plan.problem.reference_over(trajectory.duration_s)
    if reference is None or trajectory is None:
        return None

    def squared(time: np.ndarray) -> np.ndarray:
        return np.square(trajectory.position_at(time) - reference.derivative(time - trajectory.breaks_s[0])).sum(axis=1)

    time, width = trajectory.quadrature()
    largest = squared(trajectory.dense_times(16)).max()
    return float(np.sqrt(width @ squared(time) / trajectory.duration_s)), float(np.sqrt(largest))
