"""Where errors come from: each cause in its own part, the whole the error that a run of its own has."""

import itertools
import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from linkplan.controllers.imperfections.imperfections import Clock, Imperfections, Machine
from linkplan.controllers.mujoco_plant import MujocoPlant
from linkplan.controllers.rollout import ControlLoop
from linkplan.controllers.simulate import simulate
from linkplan.controllers.trackers.names import TRACKERS
from linkplan.models.errors import ProblemError
from linkplan.planner.plan.plan import Plan
from linkplan.studies.compare.compare import build_tracker, mismatch_of, track, tracking_reference
from linkplan.studies.output.document import Table
from linkplan.studies.output.text import text_of
from linkplan.studies.variations.decompose.decompose import CAUSES, decompose, error_parts
from linkplan.studies.variations.decompose.decomposition import Shares
from linkplan.studies.variations.experiment.block import run_block
from linkplan.studies.variations.experiment.experiment import Settings, experiment_of
from tests.support.plans import optimal, problem_of
from tests.support.tolerances_planner import ROUNDING, SAME_FIGURE

# The beginning of the reach: a hundred periods.
SHORT = "tracking.duration_s=0.01"
# The least exact plan that passes its certificate.
COARSE = "mesh.tolerance_deg=0.01"
AS_MODELLED = "imperfections.payload_mass_factor=1.0"
# What the parts may be off the whole by, as the study promises; measured 1e-15.
PROMISED = 0.02
# The whole against a run of another simulation loop: the same steps in another order of rounding.
SAME_RUN = 1e-6


def reach(*overrides: str, name: str = "knee-reach") -> Plan:
    """Return a built-in problem's motion, planned once, with settings of tracking and imperfections."""
    return replace(optimal(name), problem=problem_of(name, *overrides))


def parts_of(plan: Plan, tracker: str) -> dict:
    """Return the record of one tracker's error."""
    record = decompose(plan, [tracker]).to_dict()["trackers"][tracker]
    return record | record["deg"]


def split(tracker: str, *overrides: str, name: str = "knee-reach") -> dict:
    """Return the record of one tracker's error on a built-in problem with settings."""
    return parts_of(reach(*overrides, name=name), tracker)


def test_the_parts_add_up_to_the_error_of_a_run_of_its_own():
    """The same machine by `track`, which knows no ladder; and the increments' own sizes do not add up."""
    asked = ("imperfections.payload_mass_factor=1.2", "imperfections.delay_periods=1")
    found = split("pd+ff", SHORT, *asked)
    plan = reach(SHORT)
    run = track(plan, "pd+ff", mismatch_of(plan, 1.2, 1))
    rms = np.degrees(np.sqrt(np.mean(run.error_rad**2)))
    assert found["rms_error"] == pytest.approx(rms, rel=SAME_RUN)
    assert sum(found["parts"].values()) == pytest.approx(rms, rel=PROMISED)
    assert sum(found["parts"].values()) == pytest.approx(rms, rel=SAME_RUN)
    assert abs(sum(found["rms_of_increment"].values()) / rms - 1) > PROMISED


@pytest.mark.parametrize(
    ("tracker", "overrides", "cause"),
    [
        ("pd", [AS_MODELLED], "law"),
        ("pd+ff", [AS_MODELLED], "simulator"),
        ("pd+ff", ["tracking.delay_periods=20", AS_MODELLED], "sampling"),
        ("pd+ff", ["imperfections.delay_periods=20.5"], "sampling"),
        ("pd+ff", ["imperfections.period_factor=1.1"], "sampling"),
        ("lqr", ["imperfections.loop_time_constant_s=0.02"], "simulator"),
        ("lqi", ["imperfections.encoder_offset_deg=1.0"], "devices"),
        ("ct", ["imperfections.torque_constant_factor=0.8"], "devices"),
        ("gs-pd+ff", ["imperfections.payload_mass_factor=1.5"], "model"),
        ("pd+ff", ["imperfections.start_error_deg=1.0"], "model"),
    ],
)
def test_what_is_wrong_with_a_machine_is_its_largest_part(tracker, overrides, cause):
    parts = split(tracker, SHORT, *overrides)["parts"]
    assert max(parts, key=lambda name: abs(parts[name])) == cause


@pytest.mark.parametrize("tracker", ["pd+ff", "lqi", pytest.param("mpc", marks=pytest.mark.slow)])
def test_what_a_limit_takes_away_is_the_limits_part(tracker):
    light = split(tracker, "tracking.duration_s=0.03", AS_MODELLED)
    assert light["parts"]["limits"] == 0
    heavy = split(tracker, "tracking.duration_s=0.03", "imperfections.payload_mass_factor=2.5")
    assert heavy["parts"]["limits"] > 0.05 * heavy["rms_error"]


def test_a_tracker_with_its_feedforward_has_no_part_of_a_law_s():
    for tracker in TRACKERS:
        part = split(tracker, SHORT, AS_MODELLED)["parts"]["law"]
        assert (part == 0) == (tracker != "pd")


def test_the_simulator_s_part_halves_with_its_timestep():
    parts = []
    for period in (1e-4, 5e-5, 2.5e-5):  # steps are no longer than a control period
        found = split("pd+ff", SHORT, AS_MODELLED, f"tracking.period_s={period}")
        parts.append(found["rms_of_increment"]["simulator"])
    assert np.diff(np.log2(parts)) == pytest.approx(-1.0, abs=0.05)


@pytest.mark.slow
def test_a_first_order_scheme_has_a_part_of_the_plan_s_that_the_consistent_one_has_not():
    """Its velocity is not the slope of its position: no law can have both."""
    sizes = {}
    for scheme in ("trapezoid", "trapezoid-consistent"):
        plan = optimal("knee-reach", AS_MODELLED, "tracking.period_s=5e-4", f"mesh.scheme={scheme}", COARSE)
        found = parts_of(plan, "pd+ff")
        sizes[scheme] = found["rms_of_increment"]["plan"]
    assert sizes["trapezoid"] > 1e-3
    assert sizes["trapezoid"] > 20 * sizes["trapezoid-consistent"]


@pytest.mark.slow
def test_joints_of_a_mechanism_with_two_freedoms_share_every_part():
    found = split("lqr", SHORT, "imperfections.delay_periods=2", name="five-bar-reach")
    by_joint = found["parts_of_joints"]
    assert len(by_joint) == 2
    for cause, part in found["parts"].items():
        assert sum(joint[cause] for joint in by_joint.values()) == pytest.approx(part, abs=SAME_FIGURE)
    assert sum(found["parts"].values()) == pytest.approx(found["rms_error"], rel=SAME_FIGURE)
    assert all(abs(joint["sampling"]) > 0 for joint in by_joint.values())


def test_random_imperfections_are_drawn_as_an_experiment_draws_them():
    plan = reach(SHORT, "imperfections.payload_mass_factor=[0.8, 1.2]", "imperfections.delay_periods=[0.5, 2]")
    found = decompose(plan, ["lqr"], samples=5, seed=3)
    each = np.array(run_block(experiment_of(plan, Settings(trackers=("lqr",), samples=5, seed=3)), 0)["rms_error_deg"])
    assert np.ptp(each) > 0
    assert found.trackers["lqr"].deg.rms_error == pytest.approx(np.sqrt(np.mean(each**2)), rel=SAME_RUN)
    assert "5 machines" in text_of(found.blocks())


def test_a_loop_that_is_lost_on_the_way_is_said_with_what_came_in():
    found = decompose(reach("tracking.duration_s=0.05", "tracking.kd=1e5", AS_MODELLED), ["pd+ff", "lqr"])
    assert not found.found
    lost = found.trackers["pd+ff"]
    assert lost.machines == 0
    assert "lost after discretisation of the plan was switched on" in next(iter(lost.failures))
    text = text_of(found.blocks())
    assert "pd+ff, 1 of 1 machines omitted" in text
    assert "lqr" in text.splitlines()[3]


def test_tables_have_all_trackers_and_columns_add_up():
    found = decompose(reach(SHORT, "imperfections.payload_mass_factor=1.2"), TRACKERS)
    text = text_of(found.blocks())
    for name in TRACKERS:
        assert name in text
    column = [float(line.split()[-1]) for line in text.split("\n\n")[1].splitlines()[3:]]
    assert len(column) == len(CAUSES) + 1
    places = len(next(line.split()[-1] for line in text.split("\n\n")[1].splitlines()[-1:]).partition(".")[2])
    assert sum(column[:-1]) == pytest.approx(column[-1], abs=len(CAUSES) * 10.0**-places)


def test_every_tracker_has_a_panel_whose_bars_end_where_the_whole_does(tmp_path):
    found = decompose(reach(SHORT, AS_MODELLED), ["pd", "lqr"])
    figure = found.plot(tmp_path / "parts.png")
    assert (tmp_path / "parts.png").is_file()
    for axis, one in zip(figure.axes, found.trackers.values(), strict=False):
        bars = axis.patches
        assert len(bars) == len(CAUSES) + 1
        last = bars[len(CAUSES) - 1]
        assert last.get_x() + last.get_width() == pytest.approx(one.deg.rms_error)
        assert bars[-1].get_width() == pytest.approx(one.deg.rms_error)


def test_a_report_has_the_parts_and_the_plan():
    report = decompose(reach(SHORT, AS_MODELLED), ["pd+ff"]).document()
    table = next(block for section in report.sections for block in section.blocks if isinstance(block, Table))
    assert [row[0] for row in table.rows][:-1] == list(CAUSES.values())
    assert sum(float(row[1]) for row in table.rows[:-1]) == pytest.approx(float(table.rows[-1][1]), rel=1e-3)
    assert len(report.sections) > 1


def test_a_law_of_one_reference_is_refused_and_a_function_is_not():
    plan = reach(SHORT, AS_MODELLED)

    class Feedforward:
        name = "mine"

        def __init__(self, reference):
            self.reference = reference

        def effort(self, k, position, velocity):  # noqa: ARG002
            return self.reference.effort[k]

    assert list(decompose(plan, [Feedforward]).trackers) == ["mine"]
    with pytest.raises(ProblemError, match="runs at a shorter control period"):
        decompose(plan, [Feedforward(tracking_reference(plan))])


@pytest.mark.slow
def test_causes_that_act_on_each_other_have_the_mean_of_their_parts_over_both_orders():
    """A payload alone costs a tenth of a degree, limits alone less, both together ten: either order blames the last."""
    plan = reach("imperfections.payload_mass_factor=1.2", "imperfections.delay_periods=1", name="knee-sprint")
    found = parts_of(plan, "lqr")
    reference, mechanism = tracking_reference(experiment_plan(plan)), plan.problem.mechanism
    law, clock = build_tracker("lqr", plan, reference), Clock(delay_periods=1.0)
    errors = {}
    for limited, factor in itertools.product((False, True), (1.0, 1.2)):
        limit = plan.problem.limits.actuators_effort if limited else np.array([[-np.inf, np.inf]])
        plant = MujocoPlant(mechanism=mechanism, loop=ControlLoop(effort_limit=np.array(limit)))
        ran = simulate(plant, law, reference, [Imperfections(clock=clock, machine=Machine(mass_factor=factor))])
        errors[limited, factor > 1] = np.degrees(reference.position_rad - ran.pose[:, 0, mechanism.independent])
    total = errors[True, True]
    rms = np.sqrt(np.mean(total**2))

    def part(after, before) -> float:
        return float(np.mean((errors[after] - errors[before]) * total) / rms)

    first, last = part((False, True), (False, False)), part((True, True), (True, False))
    assert last > 10 * abs(first)
    assert found["parts"]["model"] == pytest.approx(0.5 * (first + last), rel=1e-6)
    limits = 0.5 * (part((True, False), (False, False)) + part((True, True), (False, True)))
    assert found["parts"]["limits"] == pytest.approx(limits, rel=1e-6)
    assert sum(found["parts"].values()) == pytest.approx(found["rms_error"], rel=SAME_RUN)


def experiment_plan(plan: Plan) -> Plan:
    """Return a plan with the longer run of experiments."""
    tracking = plan.problem.tracking.replace(duration_s=1.25 * plan.trajectory.duration_s)
    return replace(plan, problem=plan.problem.varied(tracking=tracking))


SIZES = st.tuples(st.integers(1, 7), st.integers(1, 9), st.integers(1, 4), st.integers(1, 3))
NUMBERS = st.floats(-1e3, 1e3, allow_subnormal=False)


@settings(derandomize=True, deadline=None, max_examples=100)
@given(SIZES.flatmap(lambda shape: arrays(float, shape, elements=NUMBERS)))
def test_the_parts_of_any_errors_add_up_to_their_rms(errors):
    found = in_order(errors)
    instants = errors.shape[1] * errors.shape[2]
    assert found.rms_error == pytest.approx(np.sqrt(np.sum(errors[-1] ** 2) / instants), rel=ROUNDING)
    size = max(values(found.rms_of_increment).sum(), found.rms_error)
    assert values(found.parts).sum() == pytest.approx(found.rms_error, abs=ROUNDING * size)
    of_joints = np.sum([values(one) for one in found.parts_of_joints.values()], axis=0)
    np.testing.assert_allclose(of_joints, values(found.parts), atol=ROUNDING * size)


def in_order(errors: np.ndarray) -> Shares:
    """Return the parts of errors whose causes are switched on in one order; further causes add nothing."""
    errors = np.concatenate([errors, np.repeat(errors[-1:], len(CAUSES) - len(errors), axis=0)])
    names = [str(k) for k in range(errors.shape[-1])]
    return error_parts(errors, np.diff(errors, axis=0, prepend=0.0), names)


def values(by_cause: dict[str, float], n: int = len(CAUSES)) -> np.ndarray:
    """Return the values of the first n causes."""
    return np.array(list(by_cause.values()))[:n]


def test_increments_that_are_at_right_angles_share_a_square_as_pythagoras_has_it():
    """Errors of 3 at one instant and of 4 at the next: 9/25 and 16/25 of a rms of 5 over the root of two."""
    first, second = np.array([3.0, 0.0]), np.array([3.0, 4.0])
    found = in_order(np.array([first, second])[:, :, None, None])
    np.testing.assert_allclose(values(found.parts, 2), np.array([9, 16]) / 25 * 5 / np.sqrt(2), rtol=ROUNDING)
    np.testing.assert_allclose(values(found.rms_of_increment, 2), np.array([3, 4]) / np.sqrt(2), rtol=ROUNDING)


def test_a_cause_that_opposes_another_has_a_negative_part():
    found = in_order(np.array([5.0, 2.0])[:, None, None, None])
    np.testing.assert_allclose(values(found.parts, 2), [5.0, -3.0], rtol=ROUNDING)
    assert found.rms_error == 2.0


def test_no_error_has_no_parts():
    found = in_order(np.zeros((3, 4, 1, 2)))
    assert found.rms_error == 0
    np.testing.assert_array_equal(values(found.parts), 0)


BRIEF = ("--set", "tracking.duration_s=0.005", "--trackers", "pd+ff")
HEAVY = ("--set", "imperfections.payload_mass_factor=1.2")


@pytest.mark.usefixtures("drawn_figures")
def test_the_command_says_writes_and_reports_the_same_parts(ask_json, ask, tmp_path):
    folder = tmp_path / "parts"
    code, said = ask_json("decompose", "knee-reach", *BRIEF, *HEAVY, "-o", str(folder))
    assert code == 0
    assert json.loads((folder / "decompose.json").read_text()) == said
    assert (folder / "decompose.png").stat().st_size > 10_000
    found = said["trackers"]["pd+ff"]["deg"]
    assert list(found["parts"]) == list(CAUSES) == list(said["parts"])
    assert sum(found["parts"].values()) == pytest.approx(found["rms_error"], rel=SAME_FIGURE)
    code, _, _ = ask("report", str(folder), "-o", str(tmp_path / "page.html"))
    assert code == 0
    assert "discretisation of the plan" in (tmp_path / "page.html").read_text()


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--trackers", "pdd"], 2, "unknown tracker 'pdd'"),
        (["--samples", "0"], 2, "samples must be a whole number from 1 to 1000, got 0"),
        (["--set", "imperfections.payload_mass=1"], 2, "unknown key 'imperfections.payload_mass'"),
        (["--set", "motion.duration_s=0.01"], 1, "knee-reach"),
    ],
)
def test_what_cannot_be_is_one_line(ask, words, code, said):
    got, out, err = ask("decompose", "knee-reach", *words)
    assert got == code
    line = out if code == 1 else err
    assert said in line
    assert "Traceback" not in out + err


def test_a_loop_that_is_lost_is_exit_code_one(ask):
    code, out, _ = ask("decompose", "knee-reach", *BRIEF, *HEAVY, "--set", "tracking.kd=1e6")
    assert code == 1
    assert "omitted" in out
