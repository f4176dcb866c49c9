"""What a notebook does, against `import linkplan` alone: a linkage of one's own, from MJCF text to its loop's margins."""

import base64
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import linkplan

# A crank-rocker: crank 50 mm, frame 200 mm, driven at O; A and C are its other hinges, B is closed by a connect.
CRANK_ROCKER = """
<mujoco model="crank-rocker">
  <option timestep="2e-4"/>
  <default>
    <joint axis="0 1 0" damping="0.002"/>
    <geom type="capsule" size="0.008" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="crank">
      <joint name="O"/>
      <geom fromto="0 0 0 0 0 0.05"/>
      <body name="coupler" pos="0 0 0.05">
        <joint name="A"/>
        <geom fromto="0 0 0 0.16 0 0.07"/>
      </body>
    </body>
    <body name="rocker" pos="0.2 0 0">
      <joint name="C"/>
      <geom fromto="0 0 0 -0.04 0 0.12"/>
    </body>
  </worldbody>
  <equality>
    <connect name="B" body1="coupler" body2="rocker" anchor="0.16 0 0.07" solref="0.0008 1"/>
  </equality>
  <actuator>
    <motor name="drive" joint="O" ctrllimited="true" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""


@dataclass(frozen=True)
class ComputedTorque:
    """The reference's own effort, with feedback of position and speed by gains chosen by hand."""

    reference: object
    name: str = "by hand"

    def effort(self, k, position_rad, velocity_rad_s):
        reference = self.reference
        stiff, damped = (
            5.0 * (reference.position_rad[k] - position_rad),
            0.03 * (reference.velocity_rad_s[k] - velocity_rad_s),
        )
        return reference.effort[k] + stiff + damped


@pytest.mark.slow
def test_a_notebook_from_mjcf_text_to_margins(tmp_path):
    linkage = linkplan.load_mechanism(CRANK_ROCKER)
    found = linkplan.check(linkage)
    assert found.problems == ()
    assert "crank-rocker: 1 degree of freedom (O independent of 3 joints)" in str(found)

    # Half a turn of the crank from rest to rest: least effort in a given time, then the least time.
    problem = linkplan.Problem.reach(
        linkage,
        start_deg={"O": 0.0},
        goal_deg={"O": 180.0},
        duration_s=0.3,
        limits={"effort": {"drive": [-1.0, 1.0]}, "speed_deg_s": {"C": 600.0}},
        tracking={"kp": 5.0, "kd": 0.03, "period_s": 5e-4},
        name="half-turn",
    )
    plan = linkplan.plan(problem).require()
    assert plan.certificate.passed
    assert plan.duration_s == pytest.approx(0.3)
    weak = {"effort": {"drive": [-0.2, 0.2]}}
    quickest = linkplan.plan(problem.replace(duration_s="free", minimize="time", limits=weak)).require()
    assert quickest.duration_s < 0.2

    motion = plan.sample(np.linspace(0.0, 0.3, 31))
    assert np.ptp(motion.position_deg["C"]) > 20.0
    assert np.abs(motion.effort["drive"]).max() <= 1.0
    assert np.abs(motion.speed_deg_s["C"]).max() <= 600.0 * (1 + 1e-6)
    plan.plot(tmp_path / "half-turn.png")
    plan.save(tmp_path / "half-turn")
    assert linkplan.read_plan(tmp_path / "half-turn").objective == plan.objective

    run = linkplan.track(plan, ComputedTorque)
    assert run.stable
    assert run.to_dict()["trackers"]["by hand"]["max_error_deg"] < 1.0
    side_by_side = linkplan.compare(plan, ["pd", "lqr", ComputedTorque])
    assert list(side_by_side.runs) == ["pd", "lqr", "by hand"]
    side_by_side.plot(tmp_path / "compared.png")

    loop = linkplan.bode(problem, at_deg=[{"O": 90.0}], frequency_hz=[20.0, 50.0])
    assert loop.stable
    assert loop.study.measurement["closed_loop_deviation_db"] < 0.2
    loop.plot(tmp_path / "bode.png")

    planner = linkplan.Planner()
    for goal in (180.0, 170.0):
        assert planner.plan(problem.replace(goal_deg={"O": goal})).require().status == "optimal"


# Cells, of which all but the first show something; tests/test_pages.py runs the lines that the README shows first.
SHOWN = (
    "import linkplan; plan = linkplan.plan('knee-reach')",
    "plan",
    "plan.plot()",
    "linkplan.check('slider-crank').plot('slider-crank.png')",
    "linkplan.render(plan, 'reach.gif', size_px=(160, 120), fps=5.0)",
    "linkplan.report(plan, 'reach.html')",
)


def outputs_of(cells, folder: Path) -> list:
    """Return what the cells of a notebook show as their results, by kind, in a kernel of its own."""
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    nbclient.NotebookClient(notebook, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    return [output.data for cell in notebook.cells for output in cell.outputs if output.output_type == "execute_result"]


@pytest.mark.slow
def test_figures_films_and_pages_show_themselves_in_a_fresh_kernel(tmp_path):
    """Without `%matplotlib inline`, which would choose a backend for every figure."""
    table, *shown = outputs_of(SHOWN, tmp_path)
    assert "<table" in table["text/html"]
    assert [set(data) - {"text/plain"} for data in shown] == [{"image/png"}, {"image/png"}, {"text/html"}, {"text/html"}]
    assert base64.b64decode(shown[0]["image/png"]).startswith(b"\x89PNG")
    assert shown[2]["text/html"].startswith("<img ")
    assert "data:image/gif;base64," in shown[2]["text/html"]
    assert shown[3]["text/html"].startswith("<iframe srcdoc=")
    assert (tmp_path / "reach.html").is_file()
