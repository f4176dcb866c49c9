"""A plan in phases as a result: its table, its motion over the time of all phases, its folder and its page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec import structs

from linkplan.models.errors import PlanError
from linkplan.models.poses.along import sampled
from linkplan.models.poses.assembly import follow
from linkplan.models.poses.joint_forces import closure_rows_along
from linkplan.models.poses.whole_body import centre_of_mass, total_mass
from linkplan.planner.files.manifest import read_record
from linkplan.planner.files.tables import PHASES_FILE
from linkplan.planner.limits.kinds import effort_bounds
from linkplan.planner.plan import phased
from linkplan.planner.plan.folder import read_plan
from linkplan.studies.output.animation import animation, frames_of
from linkplan.studies.output.document import Animation, Block, Facts, Plot, Report, Section, Text, table_of
from linkplan.studies.output.draw_plan import drawn_motion, save_plan
from linkplan.studies.output.figure_spec import FigureSpec
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.plan_blocks import objective_unit
from linkplan.studies.output.plan_sections import plan_sections
from linkplan.studies.output.report_file import report_of
from linkplan.studies.output.result import Result

# A smaller way of the centre of mass [m] is rounding.
_LEAST_WAY_M = 1e-9


class PhasedPlan(phased.PhasedRecord, Result, frozen=True, kw_only=True, eq=False):
    """The certified motions of all phases of a motion, or the reason why there are none; `PhasedRecord` has its fields.

    Example::

        empty = linkplan.Phase("empty", start_deg={"O": -20.0}, goal_deg={"O": 10.0})
        loaded = linkplan.Phase("loaded", payload="shank", goal_deg={"O": 30.0})
        lift = linkplan.Problem.phases("optimus-knee", [empty, loaded], motion={"duration_s": 0.4})
        plan = linkplan.plan(lift).require()
        print(plan, plan.plans[1].objective)
    """

    record_name = PHASES_FILE.removesuffix(".json")
    has_parquet = True

    @classmethod
    def read(cls, folder: Path) -> PhasedPlan:
        """Return a saved plan in phases; the motion of each phase is certified again.

        Raises:
            LinkplanError: if the folder or a file in it is missing or damaged, or a motion does not pass.
        """
        saved = read_record(folder / PHASES_FILE, cls)
        plans = [read_plan(folder / name) for name in saved.folders]
        return structs.replace(saved, plans=tuple(plans))

    @classmethod
    def of(cls, found: phased.PhasedRecord) -> PhasedPlan:
        """Return the planner's plan as a result."""
        return cls(**structs.asdict(found))

    def require(self) -> PhasedPlan:
        """Return this plan if every phase is certified.

        Raises:
            PlanError: otherwise, with the plan as `.plan`.
        """
        if not self.passed:
            raise PlanError(self.message, self)
        return self

    def __repr__(self) -> str:
        return f"PhasedPlan({self.problem!r}: {self.message})"

    def blocks(self) -> list[Block]:
        """Return the plan as a document's blocks."""
        sentence = self.message
        found: list[Block] = [
            Text(text=f"{self.problem}: {self.status}"),
            Text(text=f"{sentence[0].upper()}{sentence[1:]}", tone="good" if self.passed else "bad"),
        ]
        if self.body is not None:
            found.append(Facts(rows=self._facts()))
        if self.phases:
            heads = ["phase", "on", "begins [s]", "duration [s]", "status"]
            rows = [(p.name, ", ".join(p.on) or "air", p.begins_s, p.duration_s, p.status) for p in self.phases]
            if not self._maximised:  # there the phases' own objectives only choose among equal motions
                heads = [*heads, "objective"]
                rows = [(*row, phase.objective) for row, phase in zip(rows, self.phases, strict=True)]
            found.append(table_of("Phases", heads, rows, digits=8))
        if self.junctions:
            found.append(self._junction_table())
        return found

    @property
    def _maximised(self) -> list[str]:
        """What is maximised; empty if something is minimised."""
        return list(self.tables.get("objective", {}).get("maximize", {}))

    @property
    def objective_unit(self) -> str:
        """The unit of the objective, after a space."""
        return " m" if self._maximised else objective_unit(self.plans[0].problem) if self.plans else ""

    def _facts(self) -> list[tuple[str, str]]:
        """Return the facts on the whole motion."""
        body, facts, first = self.body, [], self.plans[0].problem
        if self.duration_s is not None:
            facts.append(("duration", f"{self.duration_s:.9g} s"))
        if self.objective is not None:
            name = " + ".join(self._maximised) or first.objective.name
            facts.append((f"objective ({name})", f"{self.objective:.10g}{self.objective_unit}"))
        if total_mass(first.mechanism) == total_mass(self.plans[-1].problem.mechanism):  # else it moves with the load
            rise = body.apex_m - body.com_start_m[2]
            rise, moved = (way if abs(way) > _LEAST_WAY_M else 0.0 for way in (rise, body.distance_m))
            facts.append(("centre of mass", f"moves {moved:.6g} m along x, rises by {rise:.8g} m to {body.apex_m:.6g} m"))
        if body.cost_of_transport is not None:
            facts.append(("cost of transport", f"{body.cost_of_transport:.4g}"))
        return facts

    def _junction_table(self) -> Block:
        heads = ["time [s]", "leaves", "touches", "impulse [N s]", "energy lost [J]"]
        rows = []
        for one in self.junctions:
            pushes = [f"{name} ({x:.4g}, {y:.4g}, {z:.4g})" for name, (x, y, z) in one.impulse_ns.items()]
            lost = one.energy_lost_j if abs(one.energy_lost_j) > 1e-9 else 0.0
            rows.append(
                (one.time_s, ", ".join(one.released), ", ".join(one.touched), "; ".join(pushes) if lost else "", lost)
            )
        return table_of("Between the phases", heads, rows, digits=6)

    def figure_specs(self) -> Iterator[tuple[str, FigureSpec]]:
        """Yield the figure of joints, efforts, contacts and the centre of mass over the time of all phases."""
        if self.plans and all(plan.trajectory is not None for plan in self.plans):
            yield "phases", FigureSpec(panels=list(self._plots()), title=f"{self.problem}: {self.message}", columns=2)

    def document(self) -> Report:
        """Return the report: the whole motion, then the sections of each phase."""
        sections = [Section(title="Overview", blocks=self.blocks())]
        if self.plans and all(plan.trajectory is not None for plan in self.plans):
            sections[0] = Section(title="Overview", blocks=[*self.blocks(), self._animation(), *self._plots()])
        for plan in self.plans:
            sections += plan_sections(plan)
        return report_of(f"Plan {self.problem}", self.message, self.passed, sections)

    def write_files(self, place: Path, *, parquet: bool) -> None:
        """Write the folder of each phase's plan, named by its number and name."""
        for name, plan in zip(self.folders, self.plans, strict=True):
            (place / name).mkdir()
            save_plan(plan, place / name, parquet=parquet)

    def _animation(self) -> Animation:
        """Return the motion through all phases, which the plots' cursors follow."""
        first, total = self.plans[0].problem, self.duration_s or 0.0
        shown = np.linspace(0.0, total, frames_of(first.mechanism))
        number = np.clip(np.searchsorted(self._begins(), shown, side="right") - 1, 0, len(self.plans) - 1)
        poses, efforts = [], []
        for k, plan in enumerate(self.plans):
            motion = plan.require_motion("draw")
            at = np.clip(shown[number == k] - self.phases[k].begins_s, 0.0, motion.duration_s)
            times = np.unique(np.concatenate([motion.dense_times(), at]))
            every = follow(plan.problem.mechanism, motion.position_at(times), motion.start_pose)
            poses.append(every[np.searchsorted(times, at)])
            efforts.append(motion.effort_at(at))
        q, u = np.vstack(poses), np.vstack(efforts)
        limit = effort_bounds(first)
        return animation(
            first.mechanism, self.problem, self.problem, shown, q, effort=u, effort_limit=limit, sites=first.sites
        )

    def _plots(self) -> Iterator[Plot]:
        """Yield the plots over the time of all phases."""
        motions = [drawn_motion(plan) for plan in self.plans]
        time = np.concatenate([begin + motion.time for begin, motion in zip(self._begins(), motions, strict=True)])
        first = self.plans[0].problem.mechanism
        q = np.vstack([motion.q for motion in motions])
        efforts = np.vstack([motion.u for motion in motions])
        joints = [Line(name=j.name, values=j.shown(q[:, k]), unit=j.unit) for k, j in enumerate(first.joints)]
        drives = [
            Line(name=a.name, values=efforts[:, k], unit=a.unit, limits=tuple(self.plans[0].problem.limits.effort[k]))
            for k, a in enumerate(first.actuators)
        ]
        place = sampled(centre_of_mass(first), q)[:, :, 0]
        centre = [
            Line(name=axis, values=place[:, k], unit="m") for k, axis in enumerate("xyz") if np.ptp(place[:, k]) > 1e-9
        ]
        drawn = (
            ("Centre of mass", "place", centre),
            ("Position of the joints", "position", joints),
            ("Effort of the actuators", "effort", drives),
            ("Forces of the ground", "force", list(self._ground(motions))),
        )
        for title, what, lines in drawn:
            yield from plots(title, what, TIME, time, lines, group=self.problem)

    def _ground(self, motions) -> Iterator[Line]:
        """Yield the components of the forces of the ground on each standing site, not a number in the air."""
        names = dict.fromkeys(name for plan in self.plans for name in plan.problem.limits.friction)
        for name in names:
            parts = []
            for plan, at in zip(self.plans, motions, strict=True):
                mechanism = plan.problem.mechanism
                if name in plan.problem.limits.friction:
                    rows = closure_rows_along(mechanism, at.q, at.v, at.a, at.u, *at.forces)
                    parts.append(rows[:, mechanism.closure_slice(mechanism.closure_names.index(name))])
                else:
                    parts.append(np.full((len(at.time), 3), np.nan))
            force = np.vstack(parts)
            for k, axis in enumerate("xyz"):
                if np.nanmax(np.abs(force[:, k]), initial=0.0) > 1e-9:
                    yield Line(name=f"{name} {axis}", values=force[:, k], unit="N")

    def _begins(self) -> list[float]:
        return [phase.begins_s for phase in self.phases]
