"""`extra_limits` and `extra_costs`: refused in one line, carried by variants, said in files, given again to a saved plan."""

import pickle

import casadi as ca
import numpy as np
import pytest

import linkplan
from linkplan import ExtraCost, ExtraLimit, Problem
from linkplan.models.errors import PlanFileError, ProblemError
from linkplan.studies.output.text import text_of
from tests.support.margins import other_margins
from tests.support.refusals import assert_refused

REACH = {"start_deg": {"O": -20.0}, "goal_deg": {"O": 20.0}, "duration_s": 0.2}


@pytest.fixture(scope="module")
def knee():
    return linkplan.load_mechanism("optimus-knee")


def angle(at):
    return at.position_rad["O"]


LIMIT = ExtraLimit(name="wide", expression=angle, upper=1.0, unit="rad")
COST = ExtraCost(name="bend", expression=lambda at: at.position_rad["C"] ** 2, weight=1e-4, unit="rad2 s")


@pytest.fixture(scope="module")
def saved(knee, tmp_path_factory):
    folder = tmp_path_factory.mktemp("extras") / "plan"
    plan = linkplan.plan(Problem.reach(knee, **REACH, extra_limits=[LIMIT], extra_costs=[COST])).require()
    plan.save(folder)
    return plan, folder


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        (lambda at: at.position_rad["Q"], "unknown joint in at.position_rad 'Q'; legal: O, A, C"),
        (lambda at: at.velocity_rad_s[0], "unknown joint in at.velocity_rad_s '0'"),
        (lambda at: at.effort["O"], "unknown actuator in at.effort 'O'; legal: act_O"),
        (lambda at: at.site("foot")[2], "unknown site 'foot' in at.site"),
        (lambda at: at.site("C"), "must return a CasADi scalar, got shape (3, 1)"),
        (lambda _: 3.0, "got a value of type float"),
        (lambda _: ca.SX(3.0), "depends on position, velocity, acceleration, jerk or effort, got a constant"),
        (lambda at: at.site("C")[5], "its expression fails with RuntimeError"),
        (lambda at: 1 if angle(at) > 0 else 0, "its expression fails with RuntimeError"),
        (lambda: 1, "its expression fails with TypeError"),
    ],
)
def test_an_expression_that_is_no_scalar_of_the_motion_is_refused_in_one_line(knee, expression, said):
    for given in (
        {"extra_limits": [ExtraLimit(name="mine", expression=expression, upper=1.0)]},
        {"extra_costs": [ExtraCost(name="mine", expression=expression)]},
    ):
        with pytest.raises(ProblemError) as refused:
            Problem.reach(knee, **REACH, **given)
        assert said in str(refused.value)
        assert str(refused.value).startswith(f"extra {'limit' if 'extra_limits' in given else 'cost'} 'mine': ")
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"name": ""}, "name must be printable text, got ''"),
        ({"name": "x" * 101}, "at most 100 characters, got 101"),
        ({"expression": 3}, "expression must be a function of an instant, got 3"),
        ({"unit": 3}, "unit must be text, got 3"),
        ({"upper": np.inf}, "needs lower < upper, one of them finite"),
        ({"lower": 2.0}, "needs lower < upper, one of them finite, got lower = 2 and upper = 1"),
        ({"upper": "1"}, "upper must be a number, got '1'"),
    ],
)
def test_a_limit_that_cannot_be_is_refused_when_it_is_made(given, said):
    assert_refused(
        lambda: ExtraLimit(**({"name": "mine", "expression": angle, "upper": 1.0} | given)), said, kind=ProblemError
    )


@pytest.mark.parametrize("weight", [-1.0, 0.0, np.inf, np.nan, "1", True])
def test_a_cost_s_weight_is_a_positive_number(weight):
    with pytest.raises(ProblemError, match="extra cost 'mine': weight must be a"):
        ExtraCost(name="mine", expression=angle, weight=weight)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"extra_limits": LIMIT}, "extra_limits must be a list of linkplan.ExtraLimit"),
        ({"extra_limits": [COST]}, "extra_limits must be a list of linkplan.ExtraLimit"),
        ({"extra_costs": [LIMIT]}, "extra_costs must be a list of linkplan.ExtraCost"),
        ({"extra_limits": [LIMIT, LIMIT]}, "different names, got 'wide' more than once"),
        ({"extra_costs": [ExtraCost(name="effort", expression=angle)]}, "the name of a term of objective.minimize"),
        ({"extra_costs": [], "minimize": {}}, "objective.minimize must name at least one of"),
        ({"minimize": {}}, "objective.minimize must name at least one of"),
    ],
)
def test_lists_that_cannot_be_are_refused_in_one_line(knee, given, said):
    assert_refused(lambda: Problem.reach(knee, **REACH, **given), said, kind=ProblemError)


def test_variants_of_a_problem_keep_its_extras_until_they_are_taken_back(knee):
    problem = Problem.reach(knee, **REACH, extra_limits=[LIMIT], extra_costs=[COST])
    for variant in (problem.replace(duration_s=0.3), problem.replace({"motion.duration_s": 0.3})):
        assert variant.extras == (LIMIT, COST)
    assert problem.replace(extra_limits=None).extras == (COST,)
    assert problem.replace(extra_costs=[]).extras == (LIMIT,)


def test_a_problem_whose_expressions_are_functions_of_a_module_goes_to_another_process(knee):
    cost = ExtraCost(name="lean", expression=angle, weight=1e-6)
    problem = Problem.reach(knee, **REACH, extra_limits=[LIMIT], extra_costs=[cost])
    again = pickle.loads(pickle.dumps(problem))
    assert [one.name for one in again.extras] == ["wide", "lean"]
    assert again.objective.weights == problem.objective.weights
    assert linkplan.plan(again).objective == linkplan.plan(problem).objective


def test_a_problem_as_a_file_says_what_it_is_without(knee):
    text = Problem.reach(knee, **REACH, extra_limits=[LIMIT], extra_costs=[COST]).to_toml()
    first, rest = text.split("\n", 1)
    assert first == "# Without the extra limit 'wide' and the extra cost 'bend': a problem file cannot contain Python code."
    assert rest == Problem.reach(knee, **REACH).to_toml()


def test_plan_text_and_report_and_record_name_extras(saved, tmp_path):
    plan, _ = saved
    assert "\nextra limit 'wide' " in text_of(plan.blocks())
    assert "effort + 0.0001 bend" in str(plan)
    page = plan.report(tmp_path / "plan.html").read_text(encoding="utf-8")
    assert "the extra limit &#x27;wide&#x27;" in page or "the extra limit 'wide'" in page
    assert [one["name"] for one in plan.to_dict()["extras"]] == ["wide", "bend"]


def test_a_saved_plan_is_read_with_its_extras(saved):
    plan, folder = saved
    again = linkplan.read_plan(folder, extra_limits=[LIMIT], extra_costs=[COST])
    assert (again.status, again.objective) == ("optimal", plan.objective)
    assert [margin.title for margin in other_margins(again.certificate)] == ["the extra limit 'wide'"]
    assert not [note for note in again.problem.notes if "extra" in note]


def test_a_saved_plan_that_is_read_without_its_extras_says_so(saved):
    plan, folder = saved
    again = linkplan.read_plan(folder)
    note = (
        "read without the extra limit 'wide' and the extra cost 'bend', Python code that the files do not contain, which was"
        " therefore not checked"
    )
    assert (again.status, again.objective) == ("optimal", plan.objective)
    assert note in again.problem.notes
    assert f"note: {note}" in str(again)


@pytest.mark.parametrize(
    "given",
    [
        {"extra_limits": [LIMIT]},
        {"extra_costs": [COST]},
        {"extra_costs": [COST], "extra_limits": [ExtraLimit(name="wide", expression=angle, upper=1.1, unit="rad")]},
    ],
)
def test_a_saved_plan_is_not_read_with_other_extras(saved, given):
    _, folder = saved
    with pytest.raises(PlanFileError, match="was planned with the extra limit 'wide' and the extra cost 'bend'"):
        linkplan.read_plan(folder, **given)


def test_a_saved_plan_whose_motion_overruns_the_limit_given_again_is_refused(saved):
    _, folder = saved
    other = ExtraLimit(name="wide", expression=lambda at: 4 * at.position_rad["O"], upper=1.0, unit="rad")
    with pytest.raises(linkplan.LinkplanError, match="the extra limit 'wide' comes to"):
        linkplan.read_plan(folder, extra_limits=[other], extra_costs=[COST])


def test_a_plan_of_extra_costs_alone_is_read_with_them_or_refused_in_a_line(knee, tmp_path):
    cost = ExtraCost(name="own effort", expression=lambda at: at.effort["act_O"] ** 2)
    linkplan.plan(Problem.reach(knee, **REACH, minimize={}, extra_costs=[cost])).require().save(tmp_path / "plan")
    assert linkplan.read_plan(tmp_path / "plan", extra_costs=[cost]).status == "optimal"
    with pytest.raises(
        PlanFileError, match="planned with the extra cost 'own effort', Python code that the files do not contain"
    ):
        linkplan.read_plan(tmp_path / "plan")
