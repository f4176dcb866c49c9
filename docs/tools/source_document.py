"""The experiment of docs/source-document.md: a sinusoid under PD, on the printed and on the corrected model.

`python -m docs.tools.source_document` prints the table of the page and writes its figure.

Its loop reads `data.sensordata` before `mj_step`. MuJoCo computes sensors before it integrates, so the loop sees the state
of one step earlier. Every run is made so, and with the present state.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkplan.controllers.imperfections.driving import driving
from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.imperfections.plant import ImperfectPlant
from linkplan.controllers.mujoco_plant import MujocoPlant, MujocoStepper
from linkplan.controllers.reference import SampledReference, sample
from linkplan.controllers.rollout import ControlLoop, Rollout
from linkplan.controllers.simulate import simulate_one
from linkplan.controllers.trackers.pd import pd, pd_gain
from linkplan.controllers.trackers.tracker import StateFeedback
from linkplan.models.mechanism import Mechanism, load_mechanism
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.problem import load_problem
from linkplan.planner.problem.reference import Sine
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.output.document import Block, Plot, table_of
from linkplan.studies.output.figure import figure_of
from linkplan.studies.output.figure_spec import FigureSpec, side_by_side
from linkplan.studies.output.lines import TIME, Line, plots
from linkplan.studies.output.text import text_of

PICTURE = Path(__file__).resolve().parents[1] / "pictures" / "desired-and-actual.png"

# The gains KP [N.m/rad] and KD [N.m.s/rad] of the document's two plots.
DOCUMENT_GAINS = ((200.0, 1.0), (200.0, 10.0))
_DURATION_S = 2.0
AS_PRINTED, CORRECTED = "as printed", "corrected"
# The same models with the other sensors: the printed one with the present state, the corrected one with late sensors.
PRINTED_IN_TIME, CORRECTED_LATE = "printed, in time", "corrected, late"
# Runs by (model, KP, KD).
DocumentRuns = dict[tuple[str, float, float], Rollout]


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class PlantAsItStands:
    """An unchanged model: it starts at the file's reference pose, with its contacts and timestep, and loops may be open.

    Of the mechanism's assembly only the choice of independent coordinates is used.
    """

    mechanism: Mechanism

    @property
    def loop(self) -> ControlLoop:
        """The actuators' own limits, without delay."""
        return ControlLoop(effort_limit=self.mechanism.effort_limit)

    def begin(
        self, reference: SampledReference, machines: Sequence[Imperfections]
    ) -> tuple[MujocoStepper, list[str | None]]:
        """Return a copy of the model for each machine. Only the machines' drives are used."""
        mechanism, n = self.mechanism, len(machines)
        one = ImperfectPlant(
            model=mechanism.model, pose=mechanism.q_of(mechanism.model.qpos0), rates=np.zeros(mechanism.n_q)
        )
        periods = [reference.period_s] * n
        drives = driving([machine.drives for machine in machines], [0.0] * n, periods, 1, self.loop.effort_limit)
        return MujocoStepper(mechanism, [one] * n, drives, 1, watched=True), [None] * n


@dataclass(frozen=True, eq=False, slots=True)
class LateSensors:
    """A law of one state that sees the state of one control period earlier; the first period has the first state."""

    law: StateFeedback

    @property
    def name(self) -> str:
        """The law's name."""
        return self.law.name

    def start(self, n: int) -> np.ndarray:
        """Return the memory (n, 2 n_s): the state before, of which the first one is not a number."""
        return np.full((n, 2 * self.law.reference.position_rad.shape[1]), np.nan)

    def step(
        self, k: int, position_rad: np.ndarray, velocity_rad_s: np.ndarray, memory: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return efforts (n, n_u) [N.m or N] and the next memory."""
        now = np.hstack([position_rad, velocity_rad_s])
        position, velocity = np.split(np.where(np.isnan(memory), now, memory), 2, axis=1)
        return self.law.effort(k, position, velocity), now


def document_runs(plan: Plan, gains: Sequence[tuple[float, float]], say: Callable[[str], None]) -> DocumentRuns:
    """Return the runs of the plan's sinusoid on the printed and on the corrected model, by (model, KP, KD)."""
    assert isinstance(plan.problem.reference, Sine)
    return _printed_runs(plan.problem.reference, gains, say) | _corrected_runs(plan, gains, say)


def _corrected_runs(plan: Plan, gains: Sequence[tuple[float, float]], say: Callable[[str], None]) -> DocumentRuns:
    mechanism, runs = plan.problem.mechanism, {}
    plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=plan.problem.limits.effort))
    reference = sample(mechanism, plan.require_motion("track"), float(mechanism.model.opt.timestep), _DURATION_S)
    for kp, kd in gains:
        law = pd(mechanism, reference, kp, kd)
        for model, of in ((CORRECTED, law), (CORRECTED_LATE, LateSensors(law))):
            say(f"{model}, KP = {kp:g}, KD = {kd:g}")
            runs[model, kp, kd] = simulate_one(plant, of, reference)
    return runs


def _printed_runs(sine: Sine, gains: Sequence[tuple[float, float]], say: Callable[[str], None]) -> DocumentRuns:
    source, runs = load_mechanism("optimus-knee-source"), {}
    plant = PlantAsItStands(mechanism=source)
    period_s = float(source.model.opt.timestep)
    time = period_s * np.arange(round(_DURATION_S / period_s))
    of_O, still = np.array([1.0, 0.0]), np.zeros(len(time))
    reference = SampledReference(
        period_s=period_s, time_s=time, pose_rad=np.tile(source.home, (len(time), 1)), cycle=None,
        position_rad=sine.derivative(time, 0) * of_O, velocity_rad_s=sine.derivative(time, 1) * of_O,
        effort=np.stack([still, still + 0.1], axis=1),  # the document sets its second actuator to a constant 0.1 N
    )  # fmt: skip
    for kp, kd in gains:
        gain = np.tile(pd_gain(np.diag(of_O), kp, kd), (reference.n, 1, 1))
        law = StateFeedback(reference=reference, gains=gain, name="pd+ff", feedforward=True)
        for model, of in ((AS_PRINTED, LateSensors(law)), (PRINTED_IN_TIME, law)):
            say(f"{model}, KP = {kp:g}, KD = {kd:g}")
            runs[model, kp, kd] = simulate_one(plant, of, reference)
    return runs


def document_rows(runs: Mapping[tuple[str, float, float], Rollout]) -> list[dict]:
    """Return the runs' metrics: error, loop gap over the second half, contacts, share of the time at the limit."""
    rows = []
    for (model, kp, kd), rollout in runs.items():
        error = np.degrees(rollout.error_rad[:, 0])
        half = len(rollout.time_s) // 2
        rows.append(
            {
                "model": model,
                "kp": kp,
                "kd": kd,
                "rms_error_deg": float(np.sqrt(np.mean(error**2))),
                "steady_gap_mean_m": float(rollout.gap_m[half:].mean()),
                "steady_gap_max_m": float(rollout.gap_m[half:].max()),
                "contacts": rollout.contacts,
                "at_limit_fraction": float(np.mean(np.abs(rollout.applied[:, 0]) >= 0.999 * rollout.effort_limit[0, 1])),
                "stable": rollout.stable,
            }
        )
    return rows


def document_blocks(runs: Mapping[tuple[str, float, float], Rollout]) -> list[Block]:
    """Return the source document's experiment, with runs by (model, KP, KD): a table, and the desired and actual angles."""
    heads = ["model", "KP [N.m/rad]", "KD [N.m.s/rad]", "rms error [deg]", "mean gap [um]"]
    heads += ["max gap [um]", "contacts", "at limit [%]", "stable"]
    cells = []
    for row in document_rows(runs):
        gaps = [1e6 * row["steady_gap_mean_m"], 1e6 * row["steady_gap_max_m"]]
        at_limit = 100 * row["at_limit_fraction"]
        error = row["rms_error_deg"]
        cells.append([row["model"], row["kp"], row["kd"], error, *gaps, row["contacts"], at_limit, row["stable"]])
    table = table_of("The source document's experiment, on its model as printed and on the corrected one", heads, cells)
    return [table, *_document_plots(runs)]


def document_figure(runs: Mapping[tuple[str, float, float], Rollout]) -> FigureSpec:
    """Return the source document's figure, with a column for each model and a row for each pair of gains."""
    panels = _document_plots(runs)
    models = dict.fromkeys(panel.title.partition(":")[0] for panel in panels)
    columns = [[panel for panel in panels if panel.title.partition(":")[0] == model] for model in models]
    return FigureSpec(panels=side_by_side(*columns), columns=len(columns))


def _document_plots(runs: Mapping[tuple[str, float, float], Rollout]) -> list[Plot]:
    found = []
    for (model, kp, kd), run in runs.items():
        if model not in (AS_PRINTED, CORRECTED):
            continue
        lines = [
            Line(name="actual", values=np.degrees(run.position_rad[:, 0]), unit="deg", look="line", colour=1),
            Line(name="desired", values=np.degrees(run.reference_rad[:, 0]), unit="deg", look="dash", colour=0),
        ]
        title = f"{model}: KP = {kp:g} N.m/rad, KD = {kd:g} N.m.s/rad"
        found += plots(title, "joint O", TIME, run.time_s, lines, group="time:document")
        ends = tuple(run.effort_limit[0].tolist())
        torque = [Line(name="torque", values=run.applied[:, 0], unit="N.m", look="line", colour=2, limits=ends)]
        found += plots(f"{model}: torque of these gains", "torque", TIME, run.time_s, torque, group="time:document")
    return found


def main() -> int:
    """Print the runs' table and write the figure of docs/source-document.md."""
    plan = plan_motion(load_problem("knee-sine")).require()
    runs = document_runs(plan, (*DOCUMENT_GAINS, (2.0, 0.02)), lambda line: print(f"  {line}", file=sys.stderr))
    print(text_of(document_blocks(runs)[:1]))
    figure_of(document_figure(runs), PICTURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
