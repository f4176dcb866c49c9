"""Runs that diverge say so in their figures: no warning of numpy's or MuJoCo's, which would reach stderr or a log file."""

import numpy as np
import pytest

from linkplan.cli.main import main
from linkplan.controllers.imperfections.imperfections import Imperfections
from linkplan.controllers.rigid_plant import RigidPlant
from linkplan.controllers.simulate import simulate
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.problem.problem import Problem
from linkplan.planner.search.planning import plan_motion
from linkplan.studies.compare.compare import Comparison, _plant, run_figures, track, tracking_reference
from linkplan.studies.compare.comparison_blocks import comparison_figure
from linkplan.studies.output.figure import figure_of
from linkplan.studies.variations.experiment.statistics import mean_of

pytestmark = pytest.mark.filterwarnings("error")
# Two links on motors without limits: what a law asks for acts.
ARM = """<mujoco><option timestep="0.001"/><worldbody>
<body name="upper"><joint name="a" axis="0 1 0"/><geom size=".03" pos=".1 0 0" contype="0"/>
<body name="lower" pos=".2 0 0"><joint name="b" axis="0 1 0"/><geom size=".03" pos=".1 0 0" contype="0"/></body></body>
</worldbody><actuator><motor name="ma" joint="a"/><motor name="mb" joint="b"/></actuator></mujoco>"""
MOTION = {
    "motion": {"kind": "reach", "start_deg": {"a": 0, "b": 0}, "goal_deg": {"a": 30, "b": 20}, "duration_s": 0.5},
    "objective": {"minimize": "effort"},
    "tracking": {"kp": 200.0, "kd": 1.0, "period_s": 0.001},
}
GAINS = [1e9, 1e100, 1e200, 1e308]


@pytest.fixture(scope="module")
def plan():
    return plan_motion(Problem.from_tables("arm", MOTION, mechanism=load_mechanism(ARM)))


def runaway(gain: float):
    """Return a law that pushes away from the reference, and what it asks for overflows in the end."""

    class Runaway:
        name = "runaway"

        def __init__(self, reference):
            self.reference = reference

        def effort(self, k, position, velocity):
            return gain * (position - self.reference.position_rad[k] + 0.001) * (1.0 + np.abs(velocity)) ** 2

    return Runaway


@pytest.mark.parametrize("gain", GAINS)
def test_a_run_that_diverges_is_measured_and_drawn_without_a_warning(plan, gain, tmp_path):
    run = track(plan, runaway(gain), None)
    assert np.abs(run.commanded).max() > 1e6
    assert run_figures(plan, run)["peak_effort"]["ma"] > 1e6
    runs = {"runaway": run}
    comparison = Comparison(plan=plan, nominal=runs, mismatch=None, mismatched={}, title="nominal", stem="nominal")
    figure_of(comparison_figure(comparison), tmp_path / "compare.png")


@pytest.mark.parametrize("gain", GAINS)
def test_machines_and_rigid_loops_that_diverge_are_logged_without_a_warning(plan, gain):
    mechanism, reference = plan.problem.mechanism, tracking_reference(plan)
    law = runaway(gain)(reference)
    ensemble = simulate(_plant(plan, None), law, reference, [Imperfections(), Imperfections()])
    assert np.nanmax(np.abs(ensemble.commanded)) > 1e6
    rigid = simulate(RigidPlant(mechanism=mechanism), law, reference)
    assert all(rigid.failure)


def test_a_mean_of_values_beyond_all_squares_has_no_bounds():
    found = mean_of(np.array([1e200, -1e200, 3e200]))
    assert found.value == pytest.approx(1e200)
    assert (found.low, found.high) == (-np.inf, np.inf)


def test_a_feedback_loop_that_diverges_is_said_to_be_unstable_and_nothing_else_is_said(tmp_path, monkeypatch, capfd):
    too_fast = {"kp": 200.0, "kd": 1.0, "period_s": 0.03}
    problem = Problem.from_tables("arm", {"mechanism": {"model": ARM}, **MOTION, "tracking": too_fast})
    (tmp_path / "arm.toml").write_text(problem.to_toml())
    monkeypatch.chdir(tmp_path)
    assert main(["bode", "arm.toml", "--tracker", "pd"]) == 1
    out, err = capfd.readouterr()
    assert "unstable" in out
    assert "warning" not in err.lower()
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
