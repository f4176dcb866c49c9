"""Errors by tolerances: slopes against closed forms and random machines."""

import numpy as np
import pytest

import linkplan
from linkplan.models.errors import ProblemError
from linkplan.models.poses.assembly import close_at
from linkplan.studies.check.kinematic_loop_report import measure
from linkplan.studies.check.tolerances import tolerances_along, with_tolerances

R, L = 0.1, 0.3
SLIDER_CRANK = f"""<mujoco><option gravity="0 0 0"/><worldbody>
<body name="crank"><joint name="t" axis="0 -1 0"/><geom size="0.01" mass="1"/>
<body name="rod" pos="{R} 0 0"><joint name="p" axis="0 -1 0"/><geom size="0.01" mass="1"/>
<site name="end" pos="{L} 0 0"/></body></body>
<body name="piston" pos="{R + L} 0 0"><joint name="x" type="slide" axis="1 0 0"/><geom size="0.01" mass="1"/>
<site name="pin"/></body></worldbody><equality><connect site1="end" site2="pin"/></equality>
<actuator><motor name="m" joint="t" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_a_piston_errs_by_the_textbook_s_slopes():
    found = linkplan.check(SLIDER_CRANK, at_deg=[40.0], tolerance={"*.length": 1e-4})
    at = next(one for one in found.tolerances if one.path == "the poses asked for")
    t = np.radians(40.0)
    s = np.sqrt(L**2 - (R * np.sin(t)) ** 2)
    slopes = {"crank.length": np.cos(t) - R * np.sin(t) ** 2 / s, "rod.length": L / s}
    of_piston = dict(zip(at.tolerance, at.slope["joint x"][0], strict=True))
    for name, slope in slopes.items():
        assert of_piston[name] == pytest.approx(slope, rel=1e-12)
    assert at.worst("joint x")[0] == pytest.approx(1e-4 * sum(map(abs, slopes.values())), rel=1e-12)
    assert at.causes("joint x", 0)[0][0] == "rod.length"
    assert "rod.length" in str(found)


def test_random_knees_spread_as_their_table_says():
    knee = linkplan.load_mechanism("optimus-knee", payload="shank")
    pins = [f"{body}.pos_{axis}" for body in ("coupler", "rocker", "B_coupler", "B_rocker") for axis in "xz"]
    machine, errors = with_tolerances(knee, dict.fromkeys(pins, 1e-4), {})
    pose = close_at(knee, np.radians([20.0]))
    table = tolerances_along(measure(knee, pose[None], "a pose"), machine, errors)
    dynamics, bound = machine.parametric_dynamics(), list(machine.dynamics.dependent)
    columns, n = [[one.name for one in machine.parameters].index(name) for name in pins], 10_000
    values = np.tile(machine.parameter_values, (n, 1))
    values[:, columns] += np.random.default_rng(1).uniform(-1e-4, 1e-4, (n, len(pins)))
    q, step = np.tile(pose, (n, 1)), dynamics.closure_step.map(n)
    for _ in range(4):
        q[:, bound] += np.array(step(q.T, values.T)[0]).T
    still = np.zeros((1, n))
    effort = dynamics.inverse_dynamics.map(n)(q.T, still, still, values.T) / dynamics.effort_map.map(n)(q.T, values.T)
    knee_deg = np.degrees(q[:, knee.joint_index("C")])
    assert table.rms("joint C")[0] == pytest.approx(knee_deg.std(), rel=0.02)
    assert table.rms("holding effort act_O")[0] == pytest.approx(np.array(effort).std(), rel=0.02)
    assert np.all(np.abs(knee_deg - knee_deg.mean()) <= 1.02 * table.worst("joint C")[0])


def test_poses_near_a_singular_one_are_left_out_and_said():
    found = linkplan.check("optimus-knee", tolerance={"*.length": 1e-4})
    (errors,) = found.tolerances
    assert errors.n_near_singular == 1
    assert "1 of 170 poses are left out" in str(found)


def test_tolerances_as_large_as_the_links_are_said_to_be_too_large():
    assert "not small at any pose" in str(linkplan.check("optimus-knee", tolerance={"*.length": 5.0}))


def test_the_tolerances_of_a_problem_are_those_of_its_parameters():
    problem = linkplan.Problem.reach(
        "optimus-knee",
        start_deg={"O": 0.0},
        goal_deg={"O": 30.0},
        duration_s=0.3,
        parameters={"coupler.length": {"tolerance": 3e-4}, "crank.mass": {"sd": 1e-3}},
    )
    (errors,) = linkplan.check(problem, tolerances=True).tolerances
    assert errors.tolerance == pytest.approx({"coupler.length": 3e-4, "crank.mass": 3e-3})
    assert errors.sd == pytest.approx({"coupler.length": 3e-4 / np.sqrt(3), "crank.mass": 1e-3})


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"rod.length": 1e-4}, r"no number of 'optimus-knee' has this name"),
        ({"crank.length": -1.0}, r"'crank.length' must be a positive number, got -1.0"),
        ({}, r"there is no tolerance"),
    ],
)
def test_tolerances_of_nothing_are_refused(asked, said):
    with pytest.raises(ProblemError, match=said):
        linkplan.check("optimus-knee", tolerances=True, tolerance=asked)


def test_the_numbers_that_parameters_can_set_are_listed():
    found = linkplan.check("optimus-knee", parameters=True)
    assert {"crank.length", "payload.mass"} & {one.name for one in found.parameters} == {"crank.length"}
    assert "coupler.length" in str(found)
