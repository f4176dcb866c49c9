"""References that are tables: the spline's rows, slopes and ends, columns of files, and refusals in one line."""

from pathlib import Path

import numpy as np
import pytest
import scipy

from linkplan.planner.problem.problem import Problem, load_problem
from tests.support.bodies import HINGE, body_problem
from tests.support.refusals import assert_refused

ROWS = "reference.time_s=[1.0, 1.2, 1.5, 2.0]"
ANGLES = "reference.position_deg.J=[10.0, 30.0, 20.0, 10.0]"
# Two links: the foot at l1 sin(a) + l2 sin(a + b) along x, and likewise with cosines downwards.
LEG = """<mujoco><option gravity="0 0 0"/><worldbody><body name="thigh"><joint name="hip" axis="0 -1 0"/>
<inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.02"/><body name="shank" pos="0 0 -0.4">
<joint name="knee" axis="0 -1 0"/><inertial pos="0 0 -0.2" mass="1" diaginertia="0.02 0.02 0.02"/>
<site name="foot" pos="0 0 -0.3"/></body></body></worldbody><actuator><motor name="m1" joint="hip" ctrlrange="-90 90"/>
<motor name="m2" joint="knee" ctrlrange="-90 90"/></actuator>
<keyframe><key name="home" qpos="0.3 -0.8"/></keyframe></mujoco>"""


def tracked(*overrides: str) -> Problem:
    """Return the problem of a hinge that follows a table."""
    return body_problem(HINGE, 'kind = "track"\n', *overrides)


def test_a_table_that_returns_is_a_periodic_spline_through_its_rows():
    reference = tracked(ROWS, ANGLES).reference
    assert reference.periodic
    assert reference.period_s == 1.0
    at = np.array([0.0, 0.2, 0.5, 1.0, 2.2, -0.5])
    np.testing.assert_allclose(np.degrees(reference.derivative(at)[:, 0]), [10, 30, 20, 10, 30, 20], atol=1e-12)
    ends = np.array([0.0, 1.0 - 1e-12])
    for order in (1, 2):
        first, last = reference.derivative(ends, order)[:, 0]
        assert first == pytest.approx(last, rel=1e-9), "speeds and accelerations return too"
        assert abs(first) > 0.1, "neither is zero by accident"


def test_a_stretched_spline_is_slower_by_its_factor():
    one = tracked(ROWS, ANGLES).reference
    time = np.linspace(0.0, 0.99, 12)
    for order in (0, 1, 2):
        np.testing.assert_allclose(one.stretched(3.0).derivative(3 * time, order), one.derivative(time, order) / 3.0**order)


@pytest.mark.parametrize(("spline", "order"), [("clamped", 1), ("natural", 2)])
def test_a_spline_that_does_not_return_ends_at_rest_or_without_acceleration(spline, order):
    reference = tracked(ROWS, "reference.position_deg.J=[0, 30, 20, 40]", f"reference.spline={spline}").reference
    assert not reference.periodic
    ends = np.array([0.0, 1.0])
    np.testing.assert_allclose(reference.derivative(ends, order), 0.0, atol=1e-12)
    assert np.abs(reference.derivative(ends, 3 - order)).min() > 0.1, "the other one is not zero by accident"
    np.testing.assert_allclose(np.degrees(reference.derivative(np.array([-1.0, 9.0]))[:, 0]), [0, 40], atol=1e-12)


def test_a_period_closes_a_table_without_its_last_row():
    asked = "reference.time_s=[0.0, 0.2, 0.5]", "reference.position_deg.J=[10, 30, 20]", "reference.period_s=1.0"
    one, other = tracked(*asked).reference, tracked(ROWS, ANGLES).reference
    time = np.linspace(0.0, 2.0, 31)
    np.testing.assert_allclose(one.derivative(time), other.derivative(time), atol=1e-12)


def test_an_unasked_spline_is_told():
    assert any("periodic cubic spline through 4 rows" in note for note in tracked(ROWS, ANGLES).notes)
    assert not any("spline" in note for note in tracked(ROWS, ANGLES, "reference.spline=natural").notes)


@pytest.mark.parametrize(
    "text", ["time_s,J_deg\n1.0,10\n1.2,30\n1.5,20\n2.0,10\n", "# recorded\nJ_deg, time_s\n\n10,1\n30,1.2\n20,1.5\n10,2\n"]
)
def test_a_file_s_columns_are_rows_and_a_saved_problem_has_them(tmp_path, text):
    (tmp_path / "model.xml").write_text(HINGE, encoding="utf-8")
    (tmp_path / "gait.csv").write_text(text, encoding="utf-8")
    path = tmp_path / "problem.toml"
    path.write_text('[mechanism]\nmodel = "model.xml"\n[motion]\nkind = "track"\n[reference]\nfile = "gait.csv"\n')
    problem = load_problem(path)
    time = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(problem.reference.derivative(time), tracked(ROWS, ANGLES).reference.derivative(time))
    (tmp_path / "gait.csv").unlink()
    again = Problem.from_tables("again", problem.to_dict())
    np.testing.assert_allclose(again.reference.derivative(time), problem.reference.derivative(time))


def test_places_of_a_site_are_met_in_every_row(tmp_path):
    angle = np.linspace(0.0, 2 * np.pi, 13)
    x, z = 0.1 + 0.05 * np.cos(angle), -0.55 + 0.04 * np.sin(angle)
    time = np.linspace(0.0, 1.2, 13)
    heads = "time_s,foot_x_m,foot_z_m\n"
    (tmp_path / "cam.csv").write_text(
        heads + "\n".join(f"{t},{a!r},{b!r}" for t, a, b in zip(time, x.tolist(), z.tolist(), strict=True))
    )
    problem = body_problem(LEG, 'kind = "track"\n', f"reference.file={str(tmp_path / 'cam.csv')!r}")
    assert problem.reference.periodic
    hip, knee = problem.reference.derivative(time).T
    for along, reached in (
        (x, 0.4 * np.sin(hip) + 0.3 * np.sin(hip + knee)),
        (z, -0.4 * np.cos(hip) - 0.3 * np.cos(hip + knee)),
    ):
        np.testing.assert_allclose(reached, along, atol=1e-9)
    assert np.all(knee < 0), "the branch of home"


def test_the_spline_agrees_with_another_construction():
    reference = tracked(ROWS, ANGLES).reference
    through = scipy.interpolate.make_interp_spline([0, 0.2, 0.5, 1.0], np.radians([10, 30, 20, 10.0]), bc_type="periodic")
    time = np.linspace(0.0, 1.0, 41)
    for order in (0, 1, 2):
        np.testing.assert_allclose(reference.derivative(time, order)[:, 0], through(time, order), atol=1e-9)


REFUSED = [
    (("reference.time_s=[0.0, 0.2, 0.2]", ANGLES), "reference.time_s must increase from row to row, got 0.2 after 0.2 s"),
    (("reference.time_s=[0.0, 0.2, 0.3]", ANGLES), "reference has 3 times in time_s and as many values of J, got 4"),
    ((ANGLES,), "reference.position_deg belongs to a table of rows: add reference.file or reference.time_s"),
    (("reference.phase_deg.J=3",), "[reference] needs reference.frequency_hz, a positive number, for a sinusoid, or rows"),
    ((ROWS, ANGLES, "reference.frequency_hz=2"), "reference.time_s and reference.frequency_hz are two references; keep one"),
    ((ROWS,), "reference.position_deg must name every independent joint (J); J is missing"),
    ((ROWS, "reference.position_m.J=[1, 2, 3, 4]"), "joint 'J' is a hinge; use reference.position_deg"),
    (
        (ROWS, ANGLES, "reference.period_s=0.9"),
        "reference.period_s must be larger than the last row's time, 1 s from the first",
    ),
    (
        (ROWS, "reference.position_deg.J=[0, 1, 2, 3]", "reference.spline=periodic"),
        "reference.spline 'periodic' must end where it begins (or give reference.period_s), got J = 0 first and 3 deg last",
    ),
    (
        (ROWS, "reference.position_deg.J=[0, 1, 2, 3]", "motion.duration_s=2"),
        "motion.duration_s must be that of the reference, 1 s, or 'free'",
    ),
    (
        (ROWS, "reference.position_deg.J=[0, 1, 2, 3]", "motion.kind=periodic"),
        "motion.kind 'periodic' needs a reference that repeats",
    ),
    ((ROWS, "reference.at.toe.x=[1, 2, 3, 4]"), "site 'toe'"),
    (("reference.file=nowhere.csv",), "reference.file 'nowhere.csv' cannot be read"),
]


@pytest.mark.parametrize(("asked", "words"), REFUSED, ids=[words[:40] for _, words in REFUSED])
def test_a_table_that_cannot_be_followed_is_refused_in_one_line(asked, words):
    assert_refused(lambda: tracked(*asked), words)


BAD_FILES = [
    ("time_s,J_deg\n0,1\n0.5,x\n1,2\n", "line 3, must have 2 finite numbers, got '0.5,x'"),
    ("time_s,J_deg\n0,1\n0.5\n1,2\n", "line 3, must have 2 finite numbers, got '0.5'"),
    ("time_s,J_deg\n0,1\n0.5,nan\n1,2\n", "line 3, must have 2 finite numbers"),
    ("t,J_deg\n0,1\n1,2\n", "needs a column time_s; its columns are t, J_deg"),
    (
        "time_s,K_deg\n0,1\n1,2\n",
        "has columns time_s, of joints (J_deg), or of sites (NAME_x_m, NAME_y_m, NAME_z_m) and bodies (body_NAME_deg), got",
    ),
    ("time_s,J_deg\n0,1\n", "two or more rows of numbers"),
    ("", "two or more rows of numbers; got nothing"),
    (f"time_s,J_deg\n0,1\n0.5,{'1' * 140_000}\n", "line 3, is not CSV: field larger than field limit"),
]


@pytest.mark.parametrize(("text", "words"), BAD_FILES, ids=[words[:30] for _, words in BAD_FILES])
def test_a_file_that_is_no_table_is_refused_with_its_line(tmp_path: Path, text, words):
    path = tmp_path / "table.csv"
    path.write_text(text)
    assert_refused(lambda: tracked(f"reference.file={str(path)!r}"), words)
