"""A saved plan and its model: a folder that moves keeps its plan, a model that changes is said, paths are the file's own."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from linkplan.cli.main import main
from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.planner.plan.folder import read_plan
from linkplan.planner.problem.problem import load_problem

ARM = """<mujoco model="arm">
  <option timestep="1e-4"/>
  <worldbody>
    <body name="arm">
      <joint name="J" axis="0 1 0" damping="0.01"/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="1" rgba="0.5 0.5 0.5 1"/>
    </body>
  </worldbody>
  <actuator><motor name="act" joint="J" ctrlrange="-8 8"/></actuator>
</mujoco>"""
REACH = """[mechanism]
model = "arm.xml"
[motion]
kind = "reach"
start_deg = { J = 0.0 }
goal_deg = { J = 40.0 }
duration_s = 0.5
"""


@pytest.fixture(scope="module")
def kept(tmp_path_factory) -> Path:
    """Return a folder with a model, a problem beside it, and its plan, which was made in the folder `project` beside it."""
    folder = tmp_path_factory.mktemp("saved") / "project"
    folder.mkdir()
    (folder / "arm.xml").write_text(ARM, encoding="utf-8")
    (folder / "reach.toml").write_text(REACH, encoding="utf-8")
    assert main(["plan", str(folder / "reach.toml"), "-o", str(folder / "plans" / "reach")]) == 0
    return folder.rename(folder.with_name("kept"))


@pytest.fixture
def project(kept) -> Iterator[Path]:
    """Return the folder that the plan was made in, as it was then."""
    yield Path(shutil.copytree(kept, kept.with_name("project")))
    shutil.rmtree(kept.with_name("project"), ignore_errors=True)


def changed(project: Path, old: str, new: str) -> None:
    text = (project / "arm.xml").read_text(encoding="utf-8")
    assert old in text
    (project / "arm.xml").write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.slow
def test_a_plan_whose_folder_moved_with_its_model_is_read(project, tmp_path):
    moved = project.rename(tmp_path / "elsewhere")
    plan = read_plan(moved / "plans" / "reach")
    assert plan.status == "optimal"
    assert Path(plan.problem.sections.mechanism.model) == (moved / "arm.xml").resolve()


@pytest.mark.slow
def test_a_plan_that_was_moved_alone_finds_its_model_where_it_was(project, tmp_path):
    shutil.move(project / "plans" / "reach", tmp_path / "alone")
    assert read_plan(tmp_path / "alone").status == "optimal"


@pytest.mark.slow
def test_of_two_models_the_one_that_was_planned_with_is_taken(project, tmp_path):
    """A copy of the whole project, in which the model was changed: the plan there still finds the one it was made with."""
    copy = shutil.copytree(project, tmp_path / "copy")
    changed(copy, 'mass="1"', 'mass="2"')
    assert Path(read_plan(copy / "plans" / "reach").problem.sections.mechanism.model).parent == project.resolve()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ('mass="1"', 'mass="1.001"', "its bodies"),
        ('damping="0.01"', 'damping="0.02"', "its joints"),
        ('ctrlrange="-8 8"', 'ctrlrange="-9 9"', "its actuators"),
        ("<option ", '<option gravity="0 0 -9.7" ', "its gravity and other options"),
    ],
)
def test_a_model_that_has_changed_since_is_refused_in_one_line(old, new, part, project, capsys):
    changed(project, old, new)
    capsys.readouterr()
    code = main(["track", str(project / "plans" / "reach")])
    out, err = capsys.readouterr()
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    for words in ("arm.xml' has changed since", part, "plan it again"):
        assert words in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [('rgba="0.5 0.5 0.5 1"', 'rgba="1 0 0 1"'), ('timestep="1e-4"', 'timestep="5e-5"'), ("<mujoco ", "<!-- --><mujoco ")],
)
def test_what_no_plan_hangs_on_may_change(old, new, project):
    changed(project, old, new)
    assert read_plan(project / "plans" / "reach").status == "optimal"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda record: record.pop("fingerprint"), "no fingerprint"),
        (lambda record: record["versions"].update(mujoco="3.9.0"), "planned with MuJoCo 3.9.0"),
    ],
    ids=["an older plan", "another MuJoCo"],
)
def test_a_plan_whose_model_cannot_be_compared_is_read_with_a_note(edit, said, project, capsys):
    path = project / "plans" / "reach" / "plan.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    edit(record)
    path.write_text(json.dumps(record), encoding="utf-8")
    capsys.readouterr()
    assert main(["track", str(project / "plans" / "reach"), "--tracker", "pd"]) == 0
    assert said in capsys.readouterr().err


@pytest.mark.slow
def test_a_model_that_is_gone_is_said(project):
    (project / "arm.xml").unlink()
    with pytest.raises(PlanFileError, match=r"cannot be built again: unknown model .*arm.xml"):
        read_plan(project / "plans" / "reach")


@pytest.mark.slow
def test_a_plan_outlives_the_plan_that_it_was_guessed_from(project):
    (project / "again.toml").write_text(REACH + '[guess]\nplan = "plans/reach"\n', encoding="utf-8")
    assert main(["plan", str(project / "again.toml"), "-o", str(project / "plans" / "again")]) == 0
    shutil.rmtree(project / "plans" / "reach")
    assert read_plan(project / "plans" / "again").status == "optimal"


# Paths in a problem file.


def test_paths_are_from_the_problem_s_own_folder_whatever_the_working_folder_holds(project, tmp_path, monkeypatch):
    other = tmp_path / "other"
    (other / "plans").mkdir(parents=True)
    (other / "arm.xml").write_text(ARM.replace('mass="1"', 'mass="3"'), encoding="utf-8")
    (other / "plans" / "reach").mkdir()  # no plan: to be passed over
    (project / "again.toml").write_text(REACH + '[guess]\nplan = "plans/reach"\n', encoding="utf-8")
    monkeypatch.chdir(other)
    problem = load_problem(project / "again.toml")
    assert problem.mechanism.model.body("arm").mass[0] == pytest.approx(1.0)
    assert problem.guess is not None


def test_paths_that_are_not_beside_the_problem_are_from_the_working_folder(project, tmp_path, monkeypatch):
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "reach.toml").write_text(REACH, encoding="utf-8")
    monkeypatch.chdir(project)
    assert load_problem(tmp_path / "sub" / "reach.toml").mechanism.name == "arm"


@pytest.mark.slow
def test_a_guess_that_is_nowhere_says_where_it_was_looked_for(project):
    with pytest.raises(
        ProblemError, match=r"guess.plan 'nowhere' is not a folder in .*project', the problem file's, or the working"
    ):
        load_problem(project / "reach.toml", ["guess.plan=nowhere"])
