"""The command `size` and `linkplan.size`: the same answer in a table, a record, a folder and a report; refusals."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy

import linkplan
from linkplan.studies.variations.size.candidates import motors_from, read_motors, with_motor
from tests.support.bodies import HINGE, HINGE_INERTIA, TURN
from tests.support.refusals import assert_refused
from tests.support.slider_crank import inertia, potential
from tests.support.tolerances_planner import SAME_FIGURE

MOTORS = """[[motor]]
name = "big"
peak_effort = 15.0
rms_effort = 9.0
stall_effort = 20.0
no_load_speed_deg_s = 24000
rotor_inertia = 1e-4
gears = [9, 4]

[[motor]]
name = "direct"
peak_effort = 40.0
"""
AS_CSV = """name, peak_effort, rms_effort, stall_effort, no_load_speed_deg_s, rotor_inertia, gears
big,15,9,20,24000,1e-4,9 4
direct,40,,,,,
"""


@pytest.fixture
def listed(tmp_path):
    (tmp_path / "motors.toml").write_text(MOTORS)
    return str(tmp_path / "motors.toml")


@pytest.mark.slow
@pytest.mark.usefixtures("drawn_figures")
def test_the_command_says_writes_and_reports_the_same_motors(ask_json, ask, listed, tmp_path):
    folder = tmp_path / "sized"
    code, said = ask_json("size", "knee-reach", "--motors", listed, "-o", str(folder))
    assert code == 0
    assert json.loads((folder / "size.json").read_text()) == said
    assert (folder / "size.png").stat().st_size > 10_000
    assert [(one["motor"], one["gear"], one["does"]) for one in said["motors"]] == [
        ("big", 9.0, True),
        ("direct", 1.0, False),
        ("big", 4.0, False),
    ]
    assert said["notes"] == [
        "motors without rotor_inertia have a rotor inertia of 0: direct",
        "motors without rms_effort have no limit on the rms effort: direct",
    ]
    code, _, _ = ask("report", str(folder), "-o", str(tmp_path / "page.html"))
    assert code == 0
    assert "big, gear 9 (dashed: its limits)" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_the_keys_of_the_best_motor_give_its_plan_again(listed):
    found = linkplan.size("knee-reach", listed)
    best = found.motors[0]
    settings = {f"{section}.{key}": value for section, table in best.settings.items() for key, value in table.items()}
    again = linkplan.plan(linkplan.Problem.from_file("knee-reach", settings)).require()
    assert again.objective == pytest.approx(best.objective, rel=SAME_FIGURE)
    assert again.demands()[0].peak_effort == pytest.approx(best.loads.peak_effort, rel=SAME_FIGURE)
    said = str(found)
    assert said.startswith("1 of 3 motors with gears suffices for act_O; smallest: big, gear 9 (rated ")
    assert "  gear = { act_O = 9.0 }\n  rotor_inertia = { act_O = 0.0001 }\n" in said
    assert "direct, gear 1: infeasible: act_O on joint O would have to give" in said


def test_a_csv_file_and_tables_are_the_same_list(listed, tmp_path):
    (tmp_path / "motors.csv").write_text(AS_CSV)
    tables = [
        {"name": "big", "peak_effort": 15, "rms_effort": 9, "stall_effort": 20, "no_load_speed_deg_s": 24000}
        | {"rotor_inertia": 1e-4, "gears": (9, 4)},
        {"name": "direct", "peak_effort": 40},
    ]
    assert read_motors(Path(listed)) == read_motors(tmp_path / "motors.csv") == motors_from({"motor": tables})


@pytest.mark.slow
def test_no_motor_that_does_is_exit_code_one(ask, tmp_path):
    (tmp_path / "weak.csv").write_text("name,peak_effort\nweak,5\n")
    code, out, _ = ask("size", "knee-reach", "--motors", str(tmp_path / "weak.csv"))
    assert code == 1
    assert out.startswith("none of 1 motors with gears suffices for act_O in knee-reach; the nearest is weak, gear 1\n")


@pytest.mark.slow
def test_of_several_actuators_one_gets_the_motors_and_the_others_keep_their_limits():
    motors = [{"name": "M", "peak_effort": 4.0, "rotor_inertia": 1e-4, "gears": [5]}]
    with pytest.raises(linkplan.LinkplanError, match=r"actuator must be one of act_O1, act_O2: name the one to size"):
        linkplan.size("five-bar-reach", motors)
    problem = linkplan.Problem.from_file("five-bar-reach")
    found = linkplan.size(problem, motors, actuator="act_O2")
    (one,) = found.motors
    assert found.plan.problem.limits.effort[0].tolist() == problem.limits.effort[0].tolist()
    assert found.plan.problem.limits.effort[1].tolist() == [-4.0, 4.0]
    assert one.loads.peak_effort == pytest.approx(found.plan.demands()[1].peak_effort, rel=SAME_FIGURE)
    assert one.speed_up >= 1.0


def test_a_reserve_and_what_the_list_replaces_are_kept_and_said():
    line = {"stall_effort": 9.0, "no_load_speed_deg_s": 3000.0}
    limits = {"effort": {"motor": [-1.0, 1.0]}, "reserve": 0.2}
    problem = quarter_turn(duration_s=1.5, limits=limits, motors={"motor": line})
    motors = [{"name": "M", "peak_effort": 4.0, "rms_effort": 4.0, "rotor_inertia": 0.0}]
    found = linkplan.size(problem, motors)
    assert found.motors[0].peak_limit == pytest.approx(0.8 * 4.0, rel=1e-12)
    assert found.motors[0].loads.peak_share == pytest.approx(found.motors[0].loads.peak_effort / 3.2, rel=1e-12)
    assert found.motors[0].loads.line_share is None
    assert found.notes == ["the list replaces limits.effort.motor and motors.motor"]


def test_a_cable_that_only_pulls_does_not_push_with_another_motor_either():
    problem = linkplan.Problem.from_file("gripper-close")
    assert problem.limits.effort.tolist() == [[0.0, 20.0]]
    (motor,) = motors_from({"motor": [{"name": "M", "peak_effort": 30.0}]})
    assert with_motor(problem, 0, motor, 2.0).limits.effort.tolist() == [[0.0, 30.0]]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "motor is missing; it must be a list of 1 to 1000 tables ([[motor]])"),
        ("motor = []", "motor must be a list of 1 to 1000 tables ([[motor]]), got []"),
        ("motor = [1]", "motor[0] must be a table"),
        ("[[motor]]\npeak_effort = 1", "motor[0].name is missing; it must be a name of 1 to 99 letters"),
        ('[[motor]]\nname = "M"', "motor 'M' needs a peak_effort or a stall_effort; got neither"),
        ('[[motor]]\nname = "M"\npeak = 1', "unknown key 'motor.M.peak' (did you mean 'peak_effort'?)"),
        ('[[motor]]\nname = "M"\npeak_effort = -1', "motor.M.peak_effort must be a positive number, got -1"),
        ('[[motor]]\nname = "M"\npeak_effort = 1\ngears = [0]', "motor.M.gears must be a positive number, got 0"),
        (2 * '[[motor]]\nname = "M"\npeak_effort = 1\n', "motors must have different names"),
        ('[[motor]]\nname = "M"\nstall_effort = 1', "motor 'M': motors.act_O.stall_effort and motors.act_O.no_load"),
        (
            '[[motor]]\nname = "M"\nstall_effort = 1\nno_load_speed_m_s = 2',
            "motor 'M': actuator 'act_O' has the unit N.m; use",
        ),
        ('[mechanism]\nmodel = "x"', "is a problem file; a list of motors must be a TOML file with [[motor]] tables"),
    ],
)
def test_lists_that_cannot_be_are_refused_in_one_line_before_planning(ask, tmp_path, text, said):
    (tmp_path / "motors.toml").write_text(text)
    code, out, err = ask("size", "knee-reach", "--motors", str(tmp_path / "motors.toml"))
    assert (code, out) == (2, "")
    assert said in err.splitlines()[-1]
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("name,peak_effort\nM,much\n", "motor.M.peak_effort must be a positive number, got 'much'"),
        ("name,peak_effort\nM,1,2\n", "has a row with more cells than its first row has keys"),
        ("name,torque\nM,1\n", "unknown key 'motor.M.torque'"),
        ("name,peak_effort,peak_effort\nM,1,2\n", "must have different keys in its first row, got 'peak_effort' twice"),
        (f"name,peak_effort\n{'M' * 140_000},1\n", "is not CSV: field larger than field limit"),
    ],
)
def test_rows_that_cannot_be_are_refused(tmp_path, text, said):
    (tmp_path / "motors.csv").write_text(text)
    assert_refused(lambda: linkplan.size("knee-reach", tmp_path / "motors.csv"), said)


def test_missing_files_servos_and_wrong_subjects_are_refused(tmp_path):
    motors = [{"name": "M", "peak_effort": 1.0}]
    with pytest.raises(linkplan.LinkplanError, match=r"motors '.*nowhere\.toml' is not a file"):
        linkplan.size("knee-reach", tmp_path / "nowhere.toml")
    assert_refused(lambda: linkplan.size("knee-reach", tmp_path), "is a folder; a list of motors")
    assert_refused(lambda: linkplan.size("knee-reach", motors, actuator="act_P"), "unknown actuator 'act_P'")
    with pytest.raises(
        linkplan.LinkplanError, match="the problem must be a Problem, a built-in problem's name or a TOML file, got"
    ):
        linkplan.size(7, motors)
    assert_refused(lambda: linkplan.size("knee-reach", motors, rest_s=-1), "rest_s must be a number of at least 0, got -1")
    with pytest.raises(linkplan.LinkplanError, match="rest_s must be 0 for a periodic motion such as knee-sine-shank"):
        linkplan.size("knee-sine-shank", motors, rest_s=1.0)
    servo = HINGE.replace('<motor name="motor" joint="J"', '<position name="motor" joint="J" kp="9"')
    problem = linkplan.Problem.reach(servo, start_deg={"J": 10}, goal_deg={"J": 100}, duration_s=1.5)
    assert_refused(lambda: linkplan.size(problem, motors), "actuator 'motor' is a servo")
    many = [{"name": f"M{k}", "peak_effort": 1.0, "gears": [1.0] * 100} for k in range(11)]
    with pytest.raises(linkplan.LinkplanError, match="at most 1000 motors with gears can be compared; the list has 1100"):
        linkplan.size("knee-reach", many)


PEAK, ROTOR = 2.0, 3e-3
GEARS = [2.0, 5.0, 10.0, 20.0, 40.0]


def quarter_turn(**motion) -> linkplan.Problem:
    return linkplan.Problem.reach(HINGE, start_deg={"J": 10.0}, goal_deg={"J": 100.0}, **motion)


def least_time(gear: float, rotor: float = ROTOR) -> float:
    """Return the least time [s] of the quarter turn: the joint's full torque forth and back on both inertias."""
    return 2.0 * np.sqrt(TURN * (HINGE_INERTIA + gear**2 * rotor) / (gear * PEAK))


@pytest.mark.slow
def test_least_times_are_those_of_the_inertia_with_the_reflected_rotor_and_the_best_gear_is_first():
    motors = [{"name": "M", "peak_effort": PEAK, "rms_effort": PEAK / 2, "rotor_inertia": ROTOR, "gears": GEARS}]
    found = linkplan.size(quarter_turn(minimize="time"), motors)
    assert [one.gear for one in found.motors] == sorted(GEARS, key=least_time)
    assert found.motors[0].gear == np.sqrt(HINGE_INERTIA / ROTOR)  # equal inertias on both sides of the gear
    for one in found.motors:
        assert one.duration_s == pytest.approx(least_time(one.gear), rel=1e-7)
        assert one.rotor_share == pytest.approx(one.gear**2 * ROTOR / (HINGE_INERTIA + one.gear**2 * ROTOR), rel=1e-12)
        assert one.rotor_inertia_after_gear == pytest.approx(one.gear**2 * ROTOR, rel=1e-12)
        # The effort is at its limit throughout, twice what the motor may give in the mean: three times as long a rest.
        assert one.loads.rms_share == pytest.approx(2.0, rel=1e-6)
        assert one.loads.needed_rest_s == pytest.approx(3.0 * least_time(one.gear), rel=1e-6)
        assert not one.does
        assert "beyond its limit of 1 N.m; a rest of" in one.reason
        assert one.margin == pytest.approx(-1.0, rel=1e-6)
        assert one.speed_up is None
    rest_s = 3.01 * max(map(least_time, GEARS))
    rested = linkplan.size(quarter_turn(minimize="time"), motors, rest_s=rest_s).motors
    assert [(one.gear, one.does) for one in rested] == [(one.gear, True) for one in found.motors]
    shares = [2.0 / np.sqrt(1.0 + rest_s / least_time(one.gear)) for one in rested]
    assert [one.loads.rms_share for one in rested] == pytest.approx(shares, rel=1e-6)


@pytest.mark.slow
def test_a_motor_too_weak_for_the_duration_lacks_what_the_least_peak_says():
    duration, gear = 0.8, 5.0
    least_peak = 4.0 * TURN * (HINGE_INERTIA + gear**2 * ROTOR) / (gear * duration**2)
    assert least_peak < PEAK
    motors = [
        {"name": name, "peak_effort": share * least_peak, "rotor_inertia": ROTOR, "gears": [gear]}
        for name, share in (("weak", 0.7), ("strong", 3.0))
    ]
    found = linkplan.size(quarter_turn(duration_s=duration, minimize="peak_effort"), motors)
    assert found.passed
    strong, weak = found.motors
    assert (strong.motor, strong.does, weak.does) == ("strong", True, False)
    assert strong.margin == pytest.approx(1.0 - 1.0 / 3.0, rel=1e-4)
    assert strong.speed_up == pytest.approx(np.sqrt(3.0), rel=1e-4)  # efforts grow with the square of the speed
    assert weak.margin == pytest.approx(1.0 - 1.0 / 0.7, rel=1e-4)
    assert weak.speed_up == pytest.approx(np.sqrt(0.7), rel=1e-4)
    assert "the shortest feasible duration is" in weak.reason


def test_a_line_limits_the_speed_of_a_sinusoid_as_its_root_says():
    """q = A sin(w t) of an inertia: u = -n_I A w^2 sin, speed n A w cos, and the line holds at every instant."""
    gear, stall, no_load, amplitude, w = 4.0, 8.0, 40.0, np.radians(60.0), 2 * np.pi
    total = HINGE_INERTIA / gear + gear * ROTOR
    motor = {"name": "M", "peak_effort": 7.0, "stall_effort": stall, "no_load_speed_deg_s": np.degrees(no_load)}
    problem = linkplan.Problem.track(HINGE, reference={"amplitude_deg": {"J": 60.0}, "frequency_hz": 1.0})
    (one,) = linkplan.size(problem, [motor | {"rotor_inertia": ROTOR, "gears": [gear]}]).motors

    def share(rate: float) -> float:
        return float(np.hypot(total * amplitude * (w * rate) ** 2 / stall, gear * amplitude * w * rate / no_load))

    assert one.tightest == "torque-speed line"
    assert one.loads.line_share == pytest.approx(share(1.0), rel=1e-5)
    assert one.margin == pytest.approx(1.0 - share(1.0), rel=1e-4)
    root = scipy.optimize.brentq(lambda rate: share(rate) - 1.0, 0.1, 10.0, xtol=1e-12)
    assert total * amplitude * (w * root) ** 2 < 7.0  # the line binds before the peak effort
    assert one.speed_up == pytest.approx(root, rel=1e-5)


def crank_terms(th: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return I, I' / 2 and V' (n,) of the bare crank at its angles, derivatives by central differences."""
    h = 1e-5
    at, above, below = ([np.array([x + d]) for x in th] for d in (0.0, h, -h))
    slopes = [
        np.array([of(x) for x in above]).ravel() - np.array([of(x) for x in below]).ravel() for of in (inertia, potential)
    ]
    return np.array([inertia(x) for x in at]).ravel(), slopes[0] / (4 * h), slopes[1] / (2 * h)


@pytest.mark.slow
def test_a_prescribed_turn_of_the_crank_loads_each_gear_as_the_closed_form_s_inverse_dynamics():
    amplitude, bias, frequency, rotor = np.radians(80.0), np.radians(90.0), 2.0, 4e-6
    time = np.linspace(0.0, 1.0 / frequency, 4001)
    w = 2 * np.pi * frequency
    th, v, a = bias + amplitude * np.sin(w * time), amplitude * w * np.cos(w * time), -amplitude * w**2 * np.sin(w * time)
    mass, bend, weight = crank_terms(th)
    joint = mass * a + bend * v**2 + weight
    loads = {gear: joint / gear + gear * rotor * a for gear in (1.0, 4.0, 12.0)}
    limit = 1.3 * np.abs(loads[4.0]).max()
    reference = {"amplitude_deg": {"O": 80.0}, "bias_deg": {"O": 90.0}, "frequency_hz": frequency}
    problem = linkplan.Problem.track("slider-crank", reference=reference)
    motor = {"name": "M", "peak_effort": limit, "rms_effort": limit, "rotor_inertia": rotor, "gears": list(loads)}
    found = linkplan.size(problem, [motor])
    for one in found.motors:
        own = loads[one.gear]
        assert one.loads.peak_effort == pytest.approx(np.abs(own).max(), rel=1e-4)  # of samples
        assert one.loads.rms_effort == pytest.approx(np.sqrt(np.trapezoid(own**2, time) * frequency), rel=1e-6)
        assert one.margin == pytest.approx(1.0 - np.abs(own).max() / limit, abs=2e-4)
        assert one.does == (np.abs(own).max() <= limit)
    assert {one.does for one in found.motors} == {True, False}

    def excess(rate: float) -> float:
        return float(np.abs(rate**2 * ((mass * a + bend * v**2) / 4 + 4 * rotor * a) + weight / 4).max()) - limit

    (middle,) = (one for one in found.motors if one.gear == 4.0)
    assert middle.speed_up == pytest.approx(scipy.optimize.brentq(excess, 1.0, 3.0), rel=1e-5)


def test_a_warm_motor_is_slowed_down_until_its_rms_effort_is_within_its_limit():
    """A pure inertia's rms effort is proportional to the square of the speed."""
    peak = 4.0 * TURN * HINGE_INERTIA / 0.8**2
    motor = {"name": "M", "peak_effort": 2 * peak, "rms_effort": 0.5 * peak, "rotor_inertia": 0.0}
    (one,) = linkplan.size(quarter_turn(duration_s=0.8), [motor]).motors
    rms = np.sqrt(12.0) * HINGE_INERTIA * TURN / 0.8**2  # of the least effort, linear in time
    assert one.loads.rms_effort == pytest.approx(rms, rel=1e-6)
    assert not one.does
    assert one.speed_up == pytest.approx(np.sqrt(0.5 * peak / rms), rel=1e-6)


SLED = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>
<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody><actuator>
<motor name="push" joint="x" ctrlrange="-9 9"/></actuator></mujoco>"""


def test_a_lead_of_a_screw_is_a_gear_in_radians_per_metre():
    problem = linkplan.Problem.reach(SLED, start_m={"x": 0.0}, goal_m={"x": 0.3}, duration_s=0.5)
    screws = [{"name": "M", "peak_effort": 0.1, "leads_m": [0.005, 0.02]}]
    found = linkplan.size(problem, screws).motors
    assert sorted(one.gear for one in found) == pytest.approx([2 * np.pi / 0.02, 2 * np.pi / 0.005])
    # m a = 2 * 6 * 0.3 / 0.25 = 14.4 N at the ends of the smoothest motion: times lead / 2 pi
    by_lead = {round(2 * np.pi / one.gear, 4): one.loads.peak_effort for one in found}
    assert by_lead[0.02] == pytest.approx(14.4 * 0.02 / (2 * np.pi), rel=1e-3)
    with pytest.raises(linkplan.LinkplanError, match="not beside gears"):
        linkplan.size(problem, [screws[0] | {"gears": [3.0]}])
    with pytest.raises(linkplan.LinkplanError, match="act_O is on joint O"):
        linkplan.size("knee-reach", screws)


LIFT = """<mujoco><option gravity="0 0 -9.81"/><worldbody><body><joint name="z" type="slide" axis="0 0 1"/>
  <geom type="box" size="0.05 0.05 0.05" mass="4"/></body></worldbody>
  <actuator><motor name="f" joint="z" ctrlrange="-400 400"/></actuator></mujoco>"""
GEARED = {"name": "geared", "peak_effort": 2.0, "rms_effort": 5.0, "rotor_inertia": 1e-4, "gears": [60.0]}


@pytest.mark.parametrize("ends", [(0.0, 0.3), (0.3, 0.0)], ids=["the motor drives", "the load drives"])
def test_the_efforts_of_a_gear_with_losses_move_the_load_as_planned_by_its_own_equations(ends):
    """Integrated as Modelica's LossyGear: the efficiency of the direction in which power passes."""
    gear, rotor, mass, forward, backward = 60.0, 1e-4, 4.0, 0.7, 0.4
    problem = linkplan.Problem.reach(LIFT, start_m={"z": ends[0]}, goal_m={"z": ends[1]}, duration_s=0.5, minimize="effort")
    found = linkplan.size(problem, [GEARED | {"efficiency": forward, "back_efficiency": backward}])
    (one,), plain = found.motors, linkplan.size(problem, [GEARED]).motors[0]
    assert one.loads.rms_effort > 1.2 * plain.loads.rms_effort or one.loads.rms_effort < 0.8 * plain.loads.rms_effort
    motion = found.plan.trajectory
    times, torque = motion.dense_times(20), one.curve[:, 1] / gear

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        pushed, found = np.interp(t, times, torque), []
        for of, share in ((True, forward), (False, 1.0 / backward)):
            a = (gear * pushed * share - mass * 9.81) / (mass + rotor * gear**2 * share)
            found.append((a, (mass * (a + 9.81) * state[1] >= 0) == of))
        return np.array([state[1], next(a for a, fits in found if fits)])

    at = np.array([0.05])  # the speed's sign decides, so that the integration begins where it moves
    first = [motion.position_at(at)[0, 0], motion.velocity_at(at)[0, 0]]
    end = scipy.integrate.solve_ivp(slope, (0.05, 0.45), first, rtol=1e-9, atol=1e-12, max_step=1e-3).y[:, -1]
    wanted = motion.position_at(np.array([0.45]))[0, 0], motion.velocity_at(np.array([0.45]))[0, 0]
    np.testing.assert_allclose(end, wanted, atol=2e-5)


def test_a_motor_whose_gear_loses_too_much_does_not_suffice():
    problem = linkplan.Problem.reach(LIFT, start_m={"z": 0.0}, goal_m={"z": 0.3}, duration_s=0.5, minimize="effort")
    (one,) = linkplan.size(problem, [GEARED | {"efficiency": 0.3}]).motors
    assert not one.does
    assert one.loads.peak_share == pytest.approx((4 * (9.81 + 7.2) / 60 / 0.3 + 1e-4 * 60 * 7.2) / 2.0, rel=1e-6)
    assert one.reason == "with the losses of its gear it uses 191.2 % of its peak effort"
