"""Loops that stand open, or singular, at the model's own pose: the nearest closed pose, to be pasted."""

import re

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from linkplan.models.closure.initial_assembly import home_text
from linkplan.models.closure.newton import KinematicLoop
from linkplan.models.errors import UnassembledError
from linkplan.models.mechanism import load_mechanism
from linkplan.planner.files.tables import parse_value
from linkplan.planner.problem.build import mechanism_from_tables
from linkplan.studies.check.inspection import inspect
from tests.support.mechanisms import replaced

# A five-bar leg drawn with all its links along x: its feet stand half a metre apart, and no Newton step closes them.
THIGH, SHIN, HIPS = 0.2, 0.25, 0.1
LEG = """<mujoco model="leg"><compiler angle="radian" autolimits="true"/><worldbody>
<body name="hip1"><joint name="m1" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><body name="shin1" pos=".2 0 0">
<joint name="k 1" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><site name="f1" pos=".25 0 0"/></body></body>
<body name="hip2" pos="-.1 0 0"><joint name="m2" axis="0 1 0"/><geom size=".01" pos="-.1 0 0"/>
<body name="shin2" pos="-.2 0 0">
<joint name="k2" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><site name="f2" pos=".25 0 0"/></body></body></worldbody>
<equality><connect name="foot" site1="f1" site2="f2"/></equality>
<actuator><motor joint="m1" ctrlrange="-3 3"/><motor joint="m2" ctrlrange="-3 3"/></actuator></mujoco>"""
# The nearest pose that Newton's starts lead to against that of SLSQP from many more, in rad of joint space.
NEAREST = 0.02
# What six decimals of a degree leave of a pose [rad].
WRITTEN = 2e-8


def offered(text: str) -> UnassembledError:
    with pytest.raises(UnassembledError) as refused:
        load_mechanism(text)
    return refused.value


def feet_apart(q: np.ndarray) -> np.ndarray:
    """Return f1 - f2 in the plane, in closed form: hinges turn about +y, from +x towards -z."""
    m1, k1, m2, k2 = q

    def along(angle: float) -> np.ndarray:
        return np.array([np.cos(angle), -np.sin(angle)])

    first = THIGH * along(m1) + SHIN * along(m1 + k1)
    second = np.array([-HIPS, 0.0]) - THIGH * along(m2) + SHIN * along(m2 + k2)
    return first - second


def test_the_offer_closes_the_loop_and_is_as_near_as_can_be():
    error = offered(LEG)
    assert error.gap_m == pytest.approx(0.5)
    q = np.radians(list(error.home["home_deg"].values()))
    assert np.linalg.norm(feet_apart(q)) < WRITTEN
    rng, best = np.random.default_rng(3), np.inf
    for _ in range(40):
        found = minimize(
            lambda q: q @ q, rng.uniform(-2, 2, 4), jac=lambda q: 2 * q, constraints={"type": "eq", "fun": feet_apart}
        )
        best = min(best, np.sqrt(found.fun)) if found.success else best
    assert np.linalg.norm(q) < best + NEAREST


def test_the_keyframe_pasted_into_the_model_mends_it():
    error = offered(LEG)
    mechanism = load_mechanism(replaced(LEG, "</mujoco>", f"{error.keyframe}</mujoco>"))
    assert mechanism.dof == 2
    assert mechanism.home_gap_m < 1e-9
    assert np.degrees(mechanism.home) == pytest.approx(list(error.home["home_deg"].values()), abs=1e-6)


def test_the_lines_pasted_into_a_problem_mend_it_and_name_joints_with_blanks():
    error = offered(LEG)
    (line,) = home_text(error.home).splitlines()
    assert '"k 1" = ' in line
    key, value = line.split(" = ", 1)
    mechanism = mechanism_from_tables({"mechanism": {"model": LEG, key: parse_value(value, key)}})
    assert np.degrees(mechanism.home) == pytest.approx(list(error.home["home_deg"].values()), abs=1e-6)
    assert line in str(error)


def test_the_offer_leaves_what_is_in_no_loop_where_it_stands():
    """A flat parallelogram is singular. A regular pose is found from random ones, in which the trunk has moved, too."""
    flat = """<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint name="float"/><geom size=".1"/>
    <body name="head"><joint name="neck" axis="0 1 0"/><geom size=".05" pos="0 0 .1"/></body>
    <body name="crank"><joint name="motor" axis="0 1 0"/><geom size=".01" pos=".05 0 0"/><body name="coupler" pos=".1 0 0">
    <joint name="pin" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/><site name="a" pos=".3 0 0"/></body></body>
    <body name="rocker" pos=".3 0 0"><joint name="pivot" axis="0 1 0"/><geom size=".01" pos=".05 0 0"/>
    <site name="b" pos=".1 0 0"/></body></body></worldbody>
    <equality><connect site1="a" site2="b"/></equality><actuator><motor joint="motor"/></actuator></mujoco>"""
    error = offered(flat)
    home = error.home["home_deg"] | error.home["home_m"]
    assert "singular" in str(error)
    assert {name for name, x in home.items() if x != 0.0} == {"motor", "pin", "pivot", "float_z"}
    assert home["float_z"] == 1.0


def test_the_offer_keeps_the_joints_ranges():
    free = offered(LEG).home["home_deg"]
    limited = replaced(LEG, '<joint name="m1" axis="0 1 0"/>', '<joint name="m1" axis="0 1 0" range="-3 0.2"/>')
    assert free["m1"] > np.degrees(0.2)  # the nearest of all is beyond the stop
    assert np.degrees(-3) <= offered(limited).home["home_deg"]["m1"] <= np.degrees(0.2) + 1e-6


def test_many_loops_are_brought_within_the_ranges_of_all_their_joints():
    leg = LEG[LEG.index('<body name="hip1">') : LEG.index("</worldbody>")].replace("k 1", "k1")
    for joint, limits in (("k1", ".3 2.6"), ("k2", "-2.6 -.3")):
        leg = replaced(leg, f'"{joint}" axis="0 1 0"', f'"{joint}" axis="0 1 0" range="{limits}"')
    legs = "".join(re.sub('name="(.+?)"', rf'name="\1_{number}"', leg) for number in range(8))
    pins = "".join(f'<connect name="foot_{n}" site1="f1_{n}" site2="f2_{n}"/>' for n in range(8))
    start = LEG[: LEG.index("<body")]
    home = offered(f"{start}{legs}</worldbody><equality>{pins}</equality></mujoco>").home["home_deg"]
    for name, value in home.items():
        low, high = {"k1": (0.3, 2.6), "k2": (-2.6, -0.3)}.get(name[:2], (-np.inf, np.inf))
        assert np.degrees(low) - 1e-6 <= value <= np.degrees(high) + 1e-6, name


# A cylinder of 0.3 m that can only grow, and a crank whose tip is `reach` from the cylinder's pivot as it is drawn.
JACK = """<mujoco model="jack"><compiler autolimits="true"/><worldbody>
<body><joint name="A" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/>
<body><joint name="s" type="slide" axis="1 0 0" {range}/><geom size=".01" pos=".2 0 0"/><site name="eye" pos=".3 0 0"/>
</body></body><body pos="{reach} 0 -.1"><joint name="B" axis="0 1 0"/><geom size=".01" pos="0 0 .1"/>
<site name="tip" pos="0 0 .1"/></body></worldbody><equality><connect name="pin" site1="eye" site2="tip"/></equality>
<actuator><motor joint="s" ctrlrange="-9 9"/></actuator></mujoco>"""


def test_an_open_reference_is_assembled_within_the_ranges():
    s = {}
    for limits in ("", 'range="0 .1"'):
        mechanism = load_mechanism(JACK.format(range=limits, reach=0.28))
        a, s[limits], b = mechanism.home
        eye = (0.3 + s[limits]) * np.array([np.cos(a), -np.sin(a)])
        assert eye == pytest.approx([0.28 + 0.1 * np.sin(b), 0.1 * np.cos(b) - 0.1], abs=1e-10)
    assert s[""] < -0.001  # the nearest of all has a cylinder that is too short
    assert 0.0 <= s['range="0 .1"'] < 0.02


def test_a_closed_reference_outside_a_range_stays_as_it_is():
    mechanism = load_mechanism(JACK.format(range='range="0.01 .1"', reach=0.3))
    assert mechanism.home == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_links_that_are_too_short_get_no_offer():
    error = offered(replaced(LEG, 'name="hip2" pos="-.1 0 0"', 'name="hip2" pos="-9 0 0"'))
    assert (error.keyframe, error.home) == ("", {})
    assert "no closed pose was found" in str(error)


@pytest.mark.parametrize(("gap_m", "is_rounding"), [(0.003, True), (0.03, False)])
def test_a_tolerance_is_named_only_for_a_gap_that_rounding_may_leave(gap_m, is_rounding):
    """Two rods of 0.4 m whose tips meet on no pose: their pivots are 0.8 m and a gap apart."""
    rods = f"""<mujoco model="rods"><worldbody>
    <body><joint name="a" axis="0 1 0"/><geom size=".01" pos=".2 0 0"/><site name="left" pos=".4 0 0"/></body>
    <body pos="{0.8 + gap_m} 0 0"><joint name="b" axis="0 1 0"/><geom size=".01" pos="-.2 0 0"/>
    <site name="right" pos="-.4 0 0"/></body></worldbody>
    <equality><connect site1="left" site2="right"/></equality></mujoco>"""
    error = offered(rods)
    assert error.gap_m == pytest.approx(gap_m, rel=0.01)
    assert ("mechanism.closure_tolerance_m" in str(error)) == is_rounding


def test_a_parallelogram_drawn_flat_is_offered_a_pose_off_the_singular_one():
    flat = """<mujoco model="flat"><worldbody>
    <body name="a"><joint name="O" axis="0 1 0"/><geom size=".01" pos=".05 0 0"/><body name="b" pos=".1 0 0">
    <joint name="A" axis="0 1 0"/><geom size=".01" pos=".1 0 0"/></body></body>
    <body name="c" pos=".2 0 0"><joint name="C" axis="0 1 0"/><geom size=".01" pos=".05 0 0"/></body></worldbody>
    <equality><connect name="B" body1="b" body2="c" anchor=".2 0 0"/></equality>
    <actuator><motor joint="O" ctrlrange="-1 1"/></actuator></mujoco>"""
    error = offered(flat)
    assert "singular" in str(error)
    mechanism = load_mechanism(replaced(flat, "</mujoco>", f"{error.keyframe}</mujoco>"))
    assert mechanism.dof == 1


def test_of_several_loops_the_one_that_stays_open_is_named():
    """Two pairs of links: the second pair is too short to meet."""
    link = (
        '<body name="{0}" pos="{1} {2} 0"><joint axis="0 1 0"/><geom size=".01" pos=".1 0 0"/>'
        '<site name="{0}" pos="{3} 0 .06"/></body>'
    )
    places = [("near1", 0, 0, 0.2), ("near2", 0.3, 0, -0.2), ("far1", 0, 1, 0.2), ("far2", 0.5, 1, -0.2)]
    bodies = "".join(link.format(*place) for place in places)
    ties = '<connect name="near" site1="near1" site2="near2"/><connect name="far" site1="far1" site2="far2"/>'
    error = offered(f"<mujoco><worldbody>{bodies}</worldbody><equality>{ties}</equality></mujoco>")
    assert error.gap_m == pytest.approx(0.5 - 2 * np.hypot(0.2, 0.06))
    assert "mm at closure far; no closed pose was found near it" in str(error)


def test_the_sparse_jacobian_of_the_loops_is_read_into_its_places():
    squeezer = load_mechanism("andrews-squeezer")
    q = ca.SX.sym("q", squeezer.n_q)
    phi = squeezer.dynamics.closure(q)
    function = ca.Function("loop", [q], [ca.densify(phi), ca.jacobian(phi, q)])
    loop = KinematicLoop(
        name=squeezer.name,
        joints=squeezer.joints,
        coordinates=squeezer.coordinates,
        closures=squeezer.closures,
        unit=np.ones(squeezer.n_q),
        function=function,
    )
    assert function.nnz_out(1) < function.numel_out(1)
    for found, wanted in zip(loop.residual(squeezer.home + 0.1), function(squeezer.home + 0.1), strict=True):
        np.testing.assert_array_equal(found, np.array(wanted).reshape(found.shape))


# A crank of 0.1 m, a coupler of 0.28 m and a rocker of 0.22 m on a base of 0.3 m, all drawn along x.
FLAT = """<mujoco model="flat"><option gravity="0 0 0"/><default><geom type="capsule" size=".005" contype="0"
conaffinity="0"/><joint axis="0 -1 0"/></default><worldbody><body><joint name="o"/><geom fromto="0 0 0 .1 0 0"/>
<body pos=".1 0 0"><joint name="a"/><geom fromto="0 0 0 .28 0 0"/><site name="k" pos=".28 0 0"/></body></body>
<body pos=".3 0 0"><joint name="d"/><geom fromto="0 0 0 .22 0 0"/><site name="r" pos=".22 0 0"/></body></worldbody>
<equality><connect name="B" site1="k" site2="r"/></equality>
<actuator><motor joint="o" ctrlrange="-3 3"/></actuator></mujoco>"""


def test_a_named_pose_that_is_far_off_is_answered_with_the_nearest_one_that_keeps_its_first_joint():
    with pytest.raises(UnassembledError, match="does not close at o = 60 deg, d = 80 deg") as refused:
        load_mechanism(FLAT, home={"o": np.radians(60.0), "d": np.radians(80.0)})
    assert str(refused.value).count("nearest closed pose found") == 1
    home = refused.value.home["home_deg"]
    assert home == pytest.approx({"o": 60.0, "a": -31.555829, "d": 90.99}, abs=1e-4)
    crank, coupler, rocker = np.radians([home["o"], home["o"] + home["a"], home["d"]])
    ends = 0.1 * np.exp(1j * crank) + 0.28 * np.exp(1j * coupler), 0.3 + 0.22 * np.exp(1j * rocker)
    assert abs(ends[0] - ends[1]) < 1e-8
    taken = load_mechanism(FLAT, home={name: np.radians(angle) for name, angle in home.items()})
    np.testing.assert_allclose(np.degrees(taken.home), [home["o"], home["a"], home["d"]], atol=1e-4)


def test_a_named_closed_home_of_an_open_model_is_no_problem():
    mechanism = mechanism_from_tables({"mechanism": {"model": FLAT, "home_deg": {"o": 60.0, "d": 91.0}}})
    found = inspect(mechanism, [])
    assert not found.problems
    assert any("closed at mechanism.home_deg" in note for note in found.notes)
