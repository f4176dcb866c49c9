"""A problem is one value: its sections say all of it, and every variation goes through them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.planner.files.tables import BUILT_IN
from linkplan.planner.plan.folder import read_plan
from linkplan.planner.plan.plan import Plan
from linkplan.planner.problem.build import ARGUMENTS
from linkplan.planner.problem.keys.key_table import key_table
from linkplan.planner.problem.keys.reading import KEYS
from linkplan.planner.problem.problem import Problem, load_problem
from linkplan.planner.search.planning import nominal_of
from tests.support.plans import optimal

QUICK = ("knee-reach", "mesh.intervals=10", "mesh.tolerance_deg=0.01")


@pytest.fixture(scope="module")
def plan() -> Plan:
    return optimal(*QUICK)


def test_gains_given_to_a_comparison_are_those_that_it_prints_and_saves(plan, tmp_path):
    found = linkplan.compare(plan, ["pd"], tracking={"kp": 50, "kd": 0.5})
    page = found.report(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "kp = 50.0" in page
    assert "kp = 200" not in page
    assert found.comparison.plan.problem.to_dict()["tracking"] == {"kp": 50.0, "kd": 0.5}


def test_a_varied_problem_is_saved_and_read_as_itself(plan, tmp_path):
    problem = plan.problem
    motion = problem.sections.motion.replace(duration_s=0.3)
    varied = problem.replace("motion.duration_s", 0.3)
    assert varied == problem.replace(motion=motion) == problem.replace(duration_s=0.3)
    assert varied == dataclasses.replace(problem, sections=problem.sections.replace(motion=motion))
    assert varied.motion.duration_s == varied.to_dict()["motion"]["duration_s"] == 0.3
    linkplan.plan(varied).save(tmp_path / "plan")
    assert read_plan(tmp_path / "plan").problem == varied


def test_values_in_si_cannot_be_replaced_behind_the_sections():
    problem = load_problem("knee-reach")
    with pytest.raises(ValueError, match="motion"):
        dataclasses.replace(problem, motion=dataclasses.replace(problem.motion, duration_s=0.3))
    searched = problem.varied(motion=dataclasses.replace(problem.motion, duration_s=0.3))
    assert searched != problem
    with pytest.raises(ProblemError, match="varied in SI"):
        searched.to_dict()


def test_a_second_variation_keeps_the_first():
    problem = load_problem("knee-reach").replace(duration_s=0.3, reserve=0.1).replace("tracking.kp", 50)
    assert (problem.motion.duration_s, problem.limits.reserve, problem.tracking.kp) == (0.3, 0.1, 50.0)
    assert problem.replace("motion.duration_s", None).motion.duration_s is None


def test_the_nominal_problem_has_no_reserve_in_its_tables():
    problem = load_problem("knee-reach")
    assert nominal_of(problem.replace(reserve=0.2)) == problem
    assert nominal_of(problem) is None


SITUATIONS = {"mechanism": {"model": "optimus-knee"}, "motion": load_problem("knee-reach").to_dict()["motion"]}


def test_a_key_that_is_set_to_its_default_is_the_same_problem_as_one_that_is_left_out():
    bare = Problem.from_tables("knee", SITUATIONS)
    tried = 0
    for row in key_table():
        if row.section in KEYS and row.default is not None and row.section not in ("reference", "force_over_time", "path"):
            own = SITUATIONS.get(row.section, {}) | {row.name: row.default}
            tables = SITUATIONS | {row.section: own}
            same = Problem.from_tables("knee", tables)
            assert (same, same.to_dict(), hash(same)) == (bare, bare.to_dict(), hash(bare)), row
            tried += 1
    assert tried > 15
    assert bare.replace(minimize="effort") == bare
    assert bare.replace(duration_s=None) == bare.replace(duration_s="free")
    assert bare.replace(mesh={"intervals": 41}) != bare


def same_values(one: Problem, other: Problem) -> bool:
    """Return True if two problems are equal, and their values in SI too."""
    limits = [(getattr(one.limits, name), getattr(other.limits, name)) for name in ("effort", "position", "speed")]
    states = [(getattr(one.motion, name), getattr(other.motion, name)) for name in ("start", "goal")]
    equal = all(a is b or np.array_equal(a, b) for a, b in (*limits, *states))
    return equal and one == other and one.to_dict() == other.to_dict() and one.objective.weights == other.objective.weights


CHANGES = st.fixed_dictionaries(
    {},
    optional={
        "limits.reserve": st.floats(0, 0.05),
        "limits.singular_margin": st.floats(0, 0.01),
        "mesh.intervals": st.integers(2, 99),
        "mesh.refine": st.sampled_from(["both", "intervals", "degree"]),
        "solver.starts": st.integers(1, 9),
        "solver.max_time_s": st.floats(1, 1e4),
        "tracking.kp": st.floats(0, 1e5),
        "tracking.delay_periods": st.integers(0, 9),
        "tracking.bandwidth_hz": st.floats(0.1, 99),
        "imperfections.period_factor": st.tuples(st.floats(0.6, 0.9), st.floats(1.0, 1.4)).map(list),
        "robust.torque_constant_factor": st.tuples(st.floats(0.8, 1.0), st.floats(1.0, 1.2)).map(list),
        "description": st.text(st.characters(codec="ascii", exclude_categories=["C"]), max_size=30),
    },
)


@pytest.mark.parametrize("name", BUILT_IN)
def test_encoded_decoded_replaced_and_written_values_are_equal(name, tmp_path_factory):
    problem, folder = load_problem(name), tmp_path_factory.mktemp(name)

    @given(CHANGES)
    @settings(max_examples=6, deadline=None, suppress_health_check=list(HealthCheck))
    def check(changes: dict) -> None:
        description = changes.pop("description", problem.sections.description)
        varied = problem.replace(changes, description=description)
        assert same_values(Problem.from_tables(name, varied.to_dict()), varied)
        assert same_values(dataclasses.replace(varied), varied)
        path = Path(folder / f"{name}.toml")
        path.write_text(varied.to_toml(), encoding="utf-8")
        assert same_values(load_problem(path), varied)
        back = {key: value for key, value in changes.items() if value is not None}
        assert same_values(problem.replace(back, description=description), varied)

    check()
    assert same_values(problem, load_problem(name))


def test_the_help_of_a_builder_has_the_sentence_of_every_key():
    text = linkplan.Problem.reach.__doc__
    assert all(f"    {name}: " in text for name in ARGUMENTS)
    assert "start_deg: Hinges' angles at the start [deg]." in text
