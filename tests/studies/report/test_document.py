"""A report as a document: what stands in it is what the plan, its certificate and its tracked runs say."""

import json
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from linkplan.models.mechanism import load_mechanism
from linkplan.planner.certificate.certificate import certify
from linkplan.planner.plan.verdict import failed
from linkplan.studies.check.whole_check import check_whole
from linkplan.studies.compare.compare import compare
from linkplan.studies.compare.tracking_result import tracking_result
from linkplan.studies.output.document import Animation, Checklist, Plane, Plot, Table, Text
from linkplan.studies.output.numbers import MAX_SAMPLES, drawn_rows, rounded
from linkplan.studies.output.plan_sections import plan_report
from linkplan.studies.output.report_file import report_html, report_of
from tests.support.linkages import RSSR
from tests.support.margins import margin_of, with_margin
from tests.support.plans import LIMIT, optimal
from tests.support.reports import blocks, texts

# Rounding of a page's numbers, of the largest of their kind.
SHOWN = 2e-5
# A page of one plan, its comparison, and a whole demo's [bytes]: the last is the task's, the others leave room under it.
PLAN_BYTES, COMPARISON_BYTES = 500_000, 900_000


@pytest.fixture(scope="module")
def report():
    return plan_report(optimal("knee-reach"))


@pytest.fixture(scope="module")
def compared():
    comparison = compare(optimal("knee-reach"), None)
    return comparison, tracking_result(comparison).document()


def test_every_axis_has_a_label_and_a_unit_and_every_line_as_many_values_as_places(report):
    for plot in blocks(report, Plot):
        assert plot.x_axis.label
        assert plot.y_axis.label
        assert plot.y_axis.unit
        for series in plot.series:
            assert len(series.y) == len(series.x if series.x is not None else plot.x)
            assert any(y is not None for y in series.y)
    for plane in blocks(report, Plane):
        assert plane.x_axis.unit
        assert plane.y_axis.unit


def test_the_times_of_plots_never_go_back(report):
    timed = [plot for plot in blocks(report, Plot) if plot.group]
    assert len(timed) > 5
    for plot in timed:
        assert np.all(np.diff(plot.x) >= 0)


def test_the_effort_s_line_is_the_plan_s_effort(report):
    plot = next(plot for plot in blocks(report, Plot) if plot.title == "Effort of the actuators")
    trajectory = optimal("knee-reach").trajectory
    within = np.array(plot.x) < trajectory.duration_s
    planned = trajectory.effort_at(np.array(plot.x)[within])[:, 0]
    # Instants are rounded, too: the effort may move on by its slope in a millionth of the duration.
    np.testing.assert_allclose(np.array(plot.series[0].y)[within], planned, atol=SHOWN * LIMIT + 1e-3)
    assert {limit.value for limit in plot.limits} == {-LIMIT, LIMIT}


def test_the_checklist_s_worst_numbers_are_the_certificate_s(report):
    certificate = optimal("knee-reach").certificate
    (checklist,) = blocks(report, Checklist)
    items = {item.label: item for item in checklist.items}
    assert abs(items["effort of act_O"].worst) == pytest.approx(certificate.peak_effort[0], rel=1e-5)
    assert items["gap of the kinematic loops"].worst == pytest.approx(certificate.closure_gap_m, rel=1e-5)
    assert items["range of A"].limit - items["range of A"].worst == pytest.approx(
        margin_of(certificate, "position", 1).left, rel=1e-4
    )
    assert all(item.passed == (item.limit is not None or None) for item in items.values())
    instants = [item.instant_s for item in items.values() if item.instant_s is not None]
    assert len(instants) > 4
    assert all(0 <= instant <= 0.16 for instant in instants)


def test_a_limit_that_is_broken_is_the_one_that_the_checklist_says_no_to():
    plan = optimal("knee-reach")
    problem = plan.problem.varied(limits=replace(plan.problem.limits, effort=0.5 * plan.problem.limits.effort))
    broken = replace(plan, problem=problem, certificate=certify(problem, plan.trajectory), verdict=failed("on purpose"))
    assert not broken.certificate.passed
    (checklist,) = blocks(plan_report(broken), Checklist)
    assert [item.label for item in checklist.items if item.passed is False] == ["effort of act_O"]


def test_notes_that_differ_in_a_number_are_counted_first_and_stand_whole_with_the_problem():
    plan = optimal("knee-reach")
    notes = [f"geom {k} touches nothing" for k in range(6)]
    noted = plan_report(replace(plan, problem=plan.problem.varied(notes=tuple(notes))))
    overview, problem = ([one.text for one in noted.sections[k].blocks if isinstance(one, Text)] for k in (0, -1))
    assert [text for text in overview if "touches" in text] == [f"{notes[0]} (and 5 more of this kind)"]
    assert [text for text in problem if "touches" in text] == notes


def test_rounding_errors_are_zero_in_the_checklist():
    plan = optimal("knee-reach")
    at_zero = replace(plan, certificate=with_margin(plan.certificate, "position", 0, value=1e-12))
    assert {item.label: item.worst for item in certificate_items(at_zero)}["range of O"] == 0.0
    assert certificate_items(plan)[0].worst == pytest.approx(plan.certificate.peak_effort[0], rel=1e-4)


def certificate_items(plan) -> list:
    (checklist,) = blocks(plan_report(plan), Checklist)
    return checklist.items


def test_the_planned_speed_stays_below_the_limit_curves_of_the_phase_plane(report):
    plane = next(one for one in blocks(report, Plane) if one.title.startswith("Phase plane"))
    curves = {curve.name: curve for curve in plane.curves}
    planned = curves["planned"]
    assert len(plane.track_times) == len(planned.x)
    for name in ("full effort from the start", "full braking into the goal"):
        limit = curves[name]
        # The square of the speed is straight where the push is constant.
        known = np.array([(x, y**2) for x, y in zip(limit.x, limit.y, strict=True) if y is not None])
        known = known[np.argsort(known[:, 0])]
        at = (np.array(planned.x) > known[0, 0]) & (np.array(planned.x) < known[-1, 0])
        assert at.sum() > 20
        above = np.sqrt(np.interp(np.array(planned.x)[at], *known.T))
        assert np.all(np.array(planned.y)[at] <= above + 0.01 * max(planned.y))


def test_bodies_of_the_animation_keep_their_lengths(report):
    (moving,) = blocks(report, Animation)
    assert moving.dimension == 2
    links = [body for body in moving.bodies if not body.fixed]
    assert [body.name for body in links] == ["crank", "coupler", "rocker"]
    for body in links:
        points = np.array(body.points, dtype=float).reshape(len(moving.times), body.n_pins, 2)
        length = np.linalg.norm(points[:, 1] - points[:, 0], axis=1)
        assert np.ptp(length) < 1e-3 * length.mean()
    assert np.ptp(np.array(links[0].points, dtype=float)) > 0.05  # it moves


def test_the_arc_of_a_hinge_has_the_effort_and_its_limits(report):
    ((drive,),) = [moving.drives for moving in blocks(report, Animation)]
    (mark,) = drive.marks
    assert (drive.name, mark.shape, drive.limits) == ("act_O", "arc", (-LIMIT, LIMIT))
    assert max(map(abs, drive.effort)) == pytest.approx(optimal("knee-reach").certificate.peak_effort[0], rel=1e-4)
    assert {abs(row[0]) for row in mark.axis} == {1}


def test_an_actuator_that_turns_the_drawing_s_way_turns_counterclockwise():
    # Seen along y, +y away from the reader, a positive turn about y goes clockwise: from z towards x.
    mechanism = load_mechanism("optimus-knee")
    found = check_whole(mechanism, None).document()
    moving = blocks(found, Animation)[0]
    crank = next(body for body in moving.bodies if body.name == "crank")
    points = np.array(crank.points, dtype=float).reshape(len(moving.times), -1, 2)
    arm = points[:, 1] - points[:, 0]
    turned = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))[-1] - np.arctan2(arm[0, 1], arm[0, 0])
    (drive,) = moving.drives
    assert np.sign(drive.marks[0].axis[0][0]) == np.sign(turned)  # the reach is swept upwards: O rises


def test_a_spatial_linkage_is_drawn_in_space():
    mechanism = load_mechanism(RSSR)
    assert {moving.dimension for moving in blocks(check_whole(mechanism, None).document(), Animation)} == {3}


def test_a_ghost_is_where_its_tracker_was(compared):
    comparison, report = compared
    moving = blocks(report, Animation)[0]
    run = comparison.nominal["pd"]
    assert [ghost.name for ghost in moving.ghosts] == ["pd", "pd+ff", "lqr"]
    crank = next(body for body in moving.ghosts[0].bodies if body.name == "crank")
    points = np.array(crank.points, dtype=float).reshape(len(moving.times), -1, 2)
    arm = points[:, 1] - points[:, 0]
    at = np.interp(moving.times, run.time_s, run.position_rad[:, 0])
    angle = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    assert np.abs(np.abs(angle - angle[0]) - np.abs(at - at[0])).max() < 1e-3
    planned = comparison.plan.trajectory.position_at(np.array([0.08]))
    assert abs(planned[0, 0] - np.interp(0.08, run.time_s, run.position_rad[:, 0])) > np.radians(1.0)  # pd lags


def test_the_table_of_trackers_has_their_errors(compared):
    comparison, report = compared
    table = blocks(report, Table)[0]
    heads = [head for head, _ in table.columns]
    rms = {row[0]: row[heads.index("rms error")] for row in table.rows}
    error = np.degrees(comparison.nominal["pd"].error_rad[:, 0])
    assert rms["pd"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-4)
    assert dict(table.columns)["rms error"] == "deg"


def test_pages_are_small(report, compared):
    assert len(report_html(report)) < PLAN_BYTES
    assert len(report_html(compared[1])) < COMPARISON_BYTES


def test_no_name_ends_a_script_or_begins_an_element(report):
    hostile = '</script><img src=x onerror="alert(1)"><!-- <script>'
    page = report_html(msgspec.structs.replace(report, title=hostile, verdict=hostile))
    assert page.count("</script>") == 3
    assert "<img" not in page
    said = page.split('id="document">')[1].split("</script>")[0]
    assert json.loads(said)["title"] == hostile
    assert hostile in set(texts(json.loads(said)))


def test_a_page_asks_for_nothing_from_elsewhere(report):
    page = report_html(report)
    assert "default-src 'none'" in page
    style = page.split("<style>")[1].split("</style>")[0]
    assert "url(" not in style
    assert "@import" not in style


@pytest.mark.parametrize(
    ("verdict", "shown"),
    [
        ("no problems found", "No problems found"),
        ("nominal: pd stable", "Nominal: pd stable"),
        ("act_O to C: 51 nodes", "act_O to C: 51 nodes"),
        ("", ""),
    ],
)
def test_a_verdict_begins_with_a_capital_and_a_name_stays_as_it_is(verdict, shown):
    assert report_of("title", verdict, True, []).verdict == shown


def test_a_peak_of_one_sample_stays():
    values = np.sin(np.linspace(0, 7, 20_000))
    values[12_345] = 3.0
    rows = drawn_rows(values[:, None])
    assert 12_345 in rows
    assert len(rows) < MAX_SAMPLES


def test_a_smooth_line_is_within_what_a_screen_shows_of_all_its_samples():
    time = np.linspace(0, 2, 20_000)
    values = np.sin(2 * np.pi * 4 * time)
    rows = drawn_rows(values[:, None])
    assert np.abs(np.interp(time, time[rows], values[rows]) - values).max() < 0.01 * np.ptp(values)
    assert (rows[0], rows[-1]) == (0, len(time) - 1)


def test_few_samples_are_all_kept():
    assert len(drawn_rows(np.zeros((MAX_SAMPLES, 3)))) == MAX_SAMPLES


def test_digits_are_counted_from_the_largest():
    assert rounded(np.array([123.456789, 0.000123456])) == [123.46, 0]


def test_on_a_logarithmic_axis_every_value_has_its_own():
    assert rounded(np.array([123.456789, 0.000123456, 0.0, -1.0]), log=True) == [123.5, 0.0001235, None, None]


def test_what_is_no_number_is_none():
    assert rounded(np.array([1.0, np.nan, np.inf])) == [1, None, None]
