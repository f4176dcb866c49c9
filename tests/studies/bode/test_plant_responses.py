"""The plant from chosen efforts to chosen positions: against textbooks' transfer functions and MuJoCo's own matrices."""

import json

import mujoco
import numpy as np
import pytest
import scipy.linalg

import linkplan
from linkplan.controllers.sampling import Sampling
from linkplan.models.poses.assembly import close_at
from linkplan.studies.feedback.bode.plant_study import plant_frequencies
from tests.support.figures import curves, dots, saved_figures
from tests.support.tolerances_loops import MEASURED_DB, MEASURED_DEG

HEAD = """<mujoco><compiler angle="degree" autolimits="true"/>
  <option timestep="0.0005" integrator="implicitfast" gravity="0 0 -9.81"/>"""
# Two carts with a spring between them. The force acts on the first, m1.
M1, M2, K = 2.0, 3.0, 500.0
CARTS = f"""{HEAD}<worldbody>
  <body name="one"><joint name="one" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="{M1}"
    diaginertia="1 1 1"/></body>
  <body name="two" pos="1 0 0"><joint name="two" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="{M2}"
    diaginertia="1 1 1"/><site name="end" pos="0.1 0 0"/></body></worldbody>
  <tendon><fixed name="spring" stiffness="{K}"><joint joint="one" coef="1"/><joint joint="two" coef="-1"/></fixed></tendon>
  <actuator><motor name="push" joint="one" ctrlrange="-50 50"/></actuator></mujoco>"""
# A trolley and a load on a rope without mass, which hangs; turned by 180 deg it is a pole to balance.
TROLLEY, LOAD, ROPE, GRAVITY = 4.0, 2.0, 1.5, 9.81
CRANE = f"""{HEAD}<worldbody>
  <body name="trolley"><joint name="trolley" type="slide" axis="1 0 0"/><inertial pos="0 0 0" mass="{TROLLEY}"
    diaginertia="1 1 1"/>
    <body name="rope" euler="TURNED"><joint name="swing" axis="0 -1 0"/><inertial pos="0 0 -{ROPE}" mass="{LOAD}"
      diaginertia="1e-9 1e-9 1e-9"/><site name="load" pos="0 0 -{ROPE}"/></body></body></worldbody>
  <actuator><motor name="force" joint="trolley" ctrlrange="-90 90"/></actuator></mujoco>"""
# A motor of gear 2 turns a link through a spring in series: motor's inertia J, link's L, spring and dampers.
J, L, SPRING, AT_MOTOR, AT_LINK, GEAR = 0.02, 0.05, 150.0, 0.3, 0.1, 2.0
ELASTIC = f"""{HEAD}<worldbody>
  <body name="motor"><joint name="motor" axis="0 1 0" damping="{AT_MOTOR}"/><inertial pos="0 0 0" mass="1"
    diaginertia="{J} {J} {J}"/></body>
  <body name="link" pos="0 1 0"><joint name="link" axis="0 1 0" damping="{AT_LINK}"/><inertial pos="0 0 0" mass="1"
    diaginertia="{L} {L} {L}"/><site name="tip" pos="0.4 0 0"/></body></worldbody>
  <tendon><fixed stiffness="{SPRING}"><joint joint="motor" coef="1"/><joint joint="link" coef="-1"/></fixed></tendon>
  <actuator><motor name="drive" joint="motor" gear="{GEAR}" ctrlrange="-20 20"/></actuator></mujoco>"""
FREQUENCY_HZ = np.array([0.2, 0.9, 2.5, 7.0, 30.0])
AT = 2j * np.pi * FREQUENCY_HZ


def plant(model, efforts, positions, **options):
    """Return the responses at the only pose by name, and the whole result."""
    result = linkplan.bode(model, from_effort=efforts, to_position=positions, **options)
    (point,) = result.points
    return point.responses, result


def hertz(square):
    return np.sqrt(square) / (2 * np.pi)


def test_two_carts_have_an_anti_resonance_where_the_pushed_one_is_seen_and_none_at_the_other():
    found, _ = plant(CARTS, ["push"], ["one", "two", "end.x"], measure=False)
    swings, stands = K * (1 / M1 + 1 / M2), K / M2
    expected = {"one": (AT**2 + stands) / (M1 * AT**2 * (AT**2 + swings)), "two": K / (M1 * M2 * AT**2 * (AT**2 + swings))}
    expected["end.x"] = expected["two"]
    for name, gains in expected.items():
        one = found[f"push to {name}"]
        assert one.transfer.at(FREQUENCY_HZ) == pytest.approx(gains, rel=1e-9), name
        (mode,) = one.resonances
        assert mode.frequency_hz == pytest.approx(hertz(swings), rel=1e-10)
        assert (mode.damping_ratio, one.integrators, one.gain_at_rest) == (0.0, 2, None)
        assert one.low_frequency_gain == pytest.approx(1 / (M1 + M2), rel=1e-10)
    (mode,) = found["push to one"].anti_resonances
    assert mode.frequency_hz == pytest.approx(hertz(stands), rel=1e-10)
    assert [found[f"push to {name}"].zeros for name in ("two", "end.x")] == [(), ()]
    assert [found[f"push to {name}"].relative_degree for name in ("one", "two")] == [2, 4]


def test_a_crane_has_the_transfer_functions_of_its_equations_by_hand():
    """(M + m) x'' + m l a'' = F and x'' + l a'' + g a = 0, the load at x + l a."""
    found, _ = plant(CRANE.replace("TURNED", "0 0 0"), ["force"], ["trolley", "swing", "load.x", "load.z"], measure=False)
    pole = GRAVITY / ROPE * (1 + LOAD / TROLLEY)
    denominator = TROLLEY * AT**2 * (AT**2 + pole)
    for name, numerator in (("trolley", AT**2 + GRAVITY / ROPE), ("swing", -(AT**2) / ROPE), ("load.x", GRAVITY / ROPE)):
        gains = found[f"force to {name}"].transfer.at(FREQUENCY_HZ)
        assert gains == pytest.approx(numerator / denominator, rel=1e-6), name
    (stands,), (swings,) = found["force to trolley"].anti_resonances, found["force to swing"].resonances
    assert (stands.frequency_hz, swings.frequency_hz) == pytest.approx((hertz(GRAVITY / ROPE), hertz(pole)))
    assert found["force to swing"].integrators == 0  # the trolley's two are not seen in the swing
    assert not found["force to load.z"].moves


def test_the_trolley_of_a_pole_to_balance_is_non_minimum_phase():
    found, result = plant(CRANE.replace("TURNED", "0 180 0"), ["force"], ["trolley", "load.x"], measure=False)
    zero, pole = np.sqrt(GRAVITY / ROPE), np.sqrt(GRAVITY / ROPE * (1 + LOAD / TROLLEY))
    trolley, load = found["force to trolley"], found["force to load.x"]
    assert [root.real_rad_s for root in trolley.right_half_plane_zeros] == pytest.approx([zero], rel=1e-6)
    assert load.right_half_plane_zeros == ()
    for one in (trolley, load):
        assert [root.real_rad_s for root in one.unstable_poles] == pytest.approx([pole], rel=1e-6)
    assert not result.stable
    text = str(result)
    assert "unstable by itself, non-minimum-phase" in text
    assert f"should cross over below about {zero / (4 * np.pi):.3g} Hz, half the nearest zero" in text
    assert f"should cross over above about {pole / np.pi:.3g} Hz, twice the fastest" in text
    assert text.count("force to load.x is non-minimum-phase") == 0


def test_a_motor_behind_a_gear_and_a_spring_has_the_response_of_a_series_elastic_joint():
    """The actuator's effort passes its gear; the effort on the joint does not."""
    found, _ = plant(ELASTIC, ["drive", "motor"], ["motor", "link", "tip.z", "body.link"], measure=False)
    motor, link = J * AT**2 + AT_MOTOR * AT + SPRING, L * AT**2 + AT_LINK * AT + SPRING
    determinant = motor * link - SPRING**2
    for name, gains in (("motor", link), ("link", SPRING), ("tip.z", -0.4 * SPRING), ("body.link", SPRING)):
        for effort, gear in (("drive", GEAR), ("motor", 1.0)):
            one = found[f"{effort} to {name}"]
            assert one.transfer.at(FREQUENCY_HZ) == pytest.approx(gear * gains / determinant, rel=1e-8), (effort, name)
    (mode,) = found["drive to motor"].anti_resonances
    assert mode.frequency_hz == pytest.approx(hertz(SPRING / L), rel=1e-9)
    assert mode.damping_ratio == pytest.approx(AT_LINK / (2 * np.sqrt(SPRING * L)), rel=1e-9)
    assert found["drive to motor"].low_frequency_gain == pytest.approx(GEAR / (AT_MOTOR + AT_LINK), rel=1e-9)


def accelerations(mechanism, pose, effort, rates=None):
    """Return qacc of the closed chain by MuJoCo's inertia, forces and loop Jacobian: M a = f + J^T l, J a = 0, at rest."""
    model, data = mechanism.model, mujoco.MjData(mechanism.model)
    data.qpos[:] = mechanism.qpos_of(pose)
    data.qvel[:] = 0.0 if rates is None else rates
    data.ctrl[:] = effort
    mujoco.mj_forward(model, data)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    assert not mujoco.mj_isSparse(model)
    full = data.efc_J.reshape(-1, model.nv)[data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY]
    force = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
    free = scipy.linalg.null_space(full, rcond=1e-6)
    return free @ np.linalg.solve(free.T @ M @ free, free.T @ force), free, data


def test_a_five_bar_has_the_response_that_differences_of_mujocos_own_accelerations_give():
    """Poses beside the operating one close the loop; the tip's Jacobian is MuJoCo's. Two motors, four outputs."""
    found, result = plant("five-bar", ["act_O1", "act_O2"], ["O1", "E1", "P.x", "P.z"], measure=False)
    mechanism, point = result.mechanism, result.points[0].point
    at, h = mechanism.independent, 1e-5
    columns = [mechanism.model.joint(mechanism.joints[i].name).dofadr[0] for i in at]
    s = point.pose[at]

    def of(position, effort, speed=None):
        pose = close_at(mechanism, position)
        _, free, _ = accelerations(mechanism, pose, effort)
        rates = None if speed is None else free @ np.linalg.solve(free[columns], speed)
        return accelerations(mechanism, pose, effort, rates)[0][columns]

    assert of(s, point.hold) == pytest.approx([0.0, 0.0], abs=1e-6)
    eye = np.eye(2)
    by_s = np.stack([(of(s + h * e, point.hold) - of(s - h * e, point.hold)) / (2 * h) for e in eye], axis=1)
    by_u = np.stack([(of(s, point.hold + 0.01 * e) - of(s, point.hold)) / 0.01 for e in eye], axis=1)  # within their limits
    by_v = np.stack([(of(s, point.hold, h * e) - of(s, point.hold, -h * e)) / (2 * h) for e in eye], axis=1)
    _, free, data = accelerations(mechanism, point.pose, point.hold)
    gamma = free @ np.linalg.inv(free[columns])
    jacobian = np.zeros((3, mechanism.model.nv))
    mujoco.mj_jacSite(mechanism.model, data, jacobian, None, mechanism.model.site("P").id)
    rows = {name: gamma[mechanism.model.joint(name).dofadr[0]] for name in ("O1", "E1")}
    rows |= {"P.x": (jacobian @ gamma)[0], "P.z": (jacobian @ gamma)[2]}
    assert np.abs(by_s).max() > 1.0  # gravity acts
    for f in FREQUENCY_HZ:
        w = 2j * np.pi * f
        moves = np.linalg.solve(w**2 * eye - w * by_v - by_s, by_u)
        for k, effort in enumerate(("act_O1", "act_O2")):
            for name, row in rows.items():
                ours = found[f"{effort} to {name}"].transfer.at(np.array([f]))[0]
                assert ours == pytest.approx((row @ moves)[k], rel=2e-4, abs=1e-9), (effort, name, f)
    theirs = np.linalg.eigvals(np.block([[np.zeros((2, 2)), eye], [by_s, by_v]]))
    assert np.sort(np.abs(found["act_O1 to O1"].transfer.poles)) == pytest.approx(np.sort(np.abs(theirs)), rel=1e-4)


@pytest.mark.slow
def test_mujoco_moves_every_output_as_predicted_held_by_the_tracker():
    found, result = plant(ELASTIC, ["drive"], ["motor", "link", "tip.z", "body.link"], kp=20.0, kd=0.5)
    assert result.points[0].held_by == "pd"
    measured = 0
    for name, one in found.items():
        assert one.measured.coherence.min() > 0.999, name
        assert np.abs(one.measured.less_predicted_db).max() < MEASURED_DB, name
        assert np.abs(one.measured.less_predicted_deg).max() < MEASURED_DEG, name
        low = one.measured.frequency_hz < 8.0  # beyond, near the resonance, the simulator's steps of 0.5 ms show
        assert low.sum() > 4
        by_hand = one.transfer.at(one.measured.frequency_hz[low])
        assert np.abs(one.measured.gain[low]) == pytest.approx(np.abs(by_hand), rel=5e-3), name
        measured += 1
    assert measured == 4
    assert result.measurement["deviation_db"] < MEASURED_DB


@pytest.mark.slow
def test_a_plant_that_rests_by_itself_is_measured_without_its_unstable_tracker():
    """Ten times the damping gain that a sampled loop bears; the spring to the world holds the link."""
    held = ELASTIC.replace('name="link" axis="0 1 0"', 'name="link" axis="0 1 0" stiffness="40"')
    found, result = plant(held, ["drive"], ["link"], kp=20.0, kd=1e3, frequency_hz=[1.0, 3.0, 9.0])
    assert result.points[0].held_by == "itself"
    assert np.abs(found["drive to link"].measured.less_predicted_db).max() < MEASURED_DB
    assert found["drive to link"].gain_at_rest == pytest.approx(GEAR / 40.0, rel=1e-9)
    assert "nothing: it is stable by itself" in str(result)


def test_what_neither_a_tracker_nor_the_plant_holds_is_predicted_alone_with_one_line():
    upright = CRANE.replace("TURNED", "0 180 0")
    found, result = plant(upright, ["force"], ["trolley"])
    assert not found["force to trolley"].measured
    assert result.measurement is None
    assert result.caveats == (
        "not measured at trolley = 0 m: neither the loop of PD nor the plant by itself settles in MuJoCo",
    )
    assert result.passed


@pytest.mark.slow
def test_lqr_holds_the_pole_while_its_non_minimum_phase_trolley_is_measured():
    crane, at = CRANE.replace("TURNED", "0 180 0"), np.geomspace(1.0, 30.0, 7)
    found, result = plant(crane, ["force"], ["trolley", "load.x"], tracker="lqr", frequency_hz=at)
    assert result.points[0].held_by == "lqr"
    for one in found.values():
        known = one.measured.is_known(0.01)
        assert known.sum() > 5
        assert np.abs(one.measured.less_predicted_db[known]).max() < 0.1
        assert np.abs(one.measured.less_predicted_deg[known]).max() < 1.0


@pytest.mark.slow
def test_two_motors_of_a_loop_are_told_apart_while_both_loops_are_closed():
    """Y = G U with both commands moving: the ratio of one output to one command is not the plant."""
    found, _ = plant("five-bar", ["act_O1", "act_O2"], ["O2", "P.x"], frequency_hz=[2.0, 6.0], period_s=1e-3)
    for name, one in found.items():
        assert np.abs(one.measured.less_predicted_db).max() < 0.1, name
        assert np.abs(one.measured.less_predicted_deg).max() < 1.0, name
    # The off-diagonal response is far from that with the other loop closed, which `frd("plant")` gives.
    closed = linkplan.bode("five-bar", measure=False, period_s=1e-3).points[0].sampled
    beside = np.abs(closed.gains("plant", found["act_O1 to P.x"].measured.frequency_hz, 0))
    alone = np.abs(found["act_O2 to O2"].measured.gain)
    assert np.abs(alone / beside - 1).max() > 0.05


@pytest.mark.slow
def test_two_motors_on_one_joint_have_each_its_own_plant():
    """The second has three times the gear: with both on one freedom, commands are shared and each response is known."""
    two = f"""{HEAD}<worldbody><body><joint name="k" axis="0 1 0" armature="0.02" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/></body></worldbody>
      <actuator><motor name="a" joint="k" ctrlrange="-20 20"/><motor name="b" joint="k" gear="3" ctrlrange="-5 5"/>
      </actuator></mujoco>"""
    found, _ = plant(two, ["a", "b", "k"], ["k"], kp=20.0, kd=0.5, frequency_hz=[1.0, 4.0], at_deg=[{"k": 30.0}])
    gains = {name: one.measured.gain for name, one in found.items()}
    assert gains["b to k"] == pytest.approx(3 * gains["a to k"], rel=1e-4)
    assert gains["k to k"] == pytest.approx(gains["a to k"], rel=1e-4)
    for one in found.values():
        assert np.abs(one.measured.less_predicted_db).max() < MEASURED_DB


def test_the_plant_is_a_system_of_python_control_with_named_signals():
    found, result = plant(ELASTIC, ["drive", "motor"], ["link", "tip.z"], measure=False)
    system = result.lti()
    assert (system.input_labels, system.output_labels) == (["drive", "motor"], ["link", "tip_z"])
    for f in FREQUENCY_HZ:
        matrix = system(2j * np.pi * f)
        for j, effort in enumerate(system.input_labels):
            for i, position in enumerate(("link", "tip.z")):
                ours = found[f"{effort} to {position}"].transfer.at(np.array([f]))[0]
                assert matrix[i, j] == pytest.approx(ours, rel=1e-9)
    with pytest.raises(linkplan.LinkplanError, match="unknown pose"):
        result.lti("nowhere")


REFUSED = [
    (["--from-effort", "drve", "--to-position", "motor"], "--from-effort must name an effort of an actuator (drive) or"),
    (["--from-effort", "link", "--to-position", "motor"], "on a driven joint (motor); got 'link'"),
    (["--from-effort", "drive", "--to-position", "lnk"], "got 'lnk' (did you mean 'link'?)"),
    (
        ["--from-effort", "drive", "--to-position", "tip.w"],
        "--to-position must name a position of a joint (motor, link), a coord",
    ),
    (["--from-effort", "drive", "--to-position", "body.arm"], "unknown body in to_position 'arm'"),
    (
        ["--from-effort", "drive", "--to-position", "link,link"],
        "--to-position must name one or more, each once, got link, link",
    ),
    (["--from-effort", "drive"], "--from-effort also needs to_position"),
    (["--to-position", "link"], "--to-position also needs from_effort"),
    (
        ["--from-effort", "drive", "--to-position", "link", "--map"],
        "--map analyses the loop of a tracker; it cannot be combined",
    ),
    (["--from-effort", "drive", "--to-position", "link", "--along"], "--along analyses the loop of a tracker"),
]


@pytest.mark.parametrize(("options", "said"), REFUSED, ids=[" ".join(options) for options, _ in REFUSED])
def test_what_is_no_plant_is_refused_in_one_line(options, said, tmp_path, ask):
    (tmp_path / "elastic.xml").write_text(ELASTIC)
    code, out, err = ask("bode", str(tmp_path / "elastic.xml"), *options)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err


@pytest.mark.slow
def test_the_command_prints_saves_and_draws_a_matrix_of_responses(tmp_path, ask, monkeypatch):
    """The first words of the options are enough: --from and --to."""
    figures = saved_figures(monkeypatch)
    (tmp_path / "elastic.xml").write_text(ELASTIC)
    asked = ["--from", "drive", "--to", "motor,link", "--kp", "20", "--kd", "0.5", "--frequency-hz", "2,8"]
    code, out, _ = ask("bode", str(tmp_path / "elastic.xml"), *asked, "--json", "-o", str(tmp_path / "out"), "--report")
    assert code == 0
    said = json.loads(out)
    assert said == json.loads((tmp_path / "out" / "bode.json").read_text())
    one = said["points"][0]["responses"]["drive to motor"]
    assert one["anti_resonances"][0]["frequency_hz"] == pytest.approx(hertz(SPRING / L), rel=1e-9)
    assert max(map(abs, one["measured"]["less_predicted_db"])) < MEASURED_DB
    assert (tmp_path / "out" / "report.html").stat().st_size > 1e4
    axes = figures["plant.png"].axes
    assert [axis.get_ylabel() for axis in axes] == ["gain [dB of rad/(N.m)]", "phase [deg]"] * 2
    frequency, gain = curves(axes[0])["motor = 0 deg"]
    assert np.interp(np.log(5.0), np.log(frequency), gain) == pytest.approx(
        np.interp(np.log(5.0), np.log(one["curve"]["frequency_hz"]), one["curve"]["gain_db"]), abs=0.05
    )
    (drawn,) = [dot for dot in dots(axes[0]) if len(dot[0]) == 2]
    assert drawn[0] == pytest.approx(one["measured"]["frequency_hz"], rel=1e-3)


@pytest.mark.slow
def test_a_closed_chains_plant_is_given_at_every_pose_of_its_reach():
    result = linkplan.bode("optimus-knee", from_effort=["act_O"], to_position=["O", "C"], measure=False)
    assert len(result.points) == len(result.poses) == 7
    for point in result.points:
        both = [point.responses[f"act_O to {joint}"] for joint in ("O", "C")]
        inertia = point.point.inertia[0, 0]
        high = 2j * np.pi * np.array([1e4])
        assert (both[0].transfer.at(np.array([1e4])) * high**2).real == pytest.approx([1 / inertia], rel=1e-6)
        ratio = both[1].transfer.gain / both[0].transfer.gain
        joints = [joint.name for joint in result.mechanism.joints]
        gamma = np.array(result.mechanism.dynamics.velocity_map(point.point.pose))
        assert ratio == pytest.approx(gamma[joints.index("C"), 0], rel=1e-9)
    assert "at 7 poses" in result.message


@pytest.mark.slow
def test_a_slider_at_its_dead_centre_does_not_move_and_is_measured_elsewhere():
    poses = [{"O": -180.0}, {"O": -128.6}]
    options = {"at_deg": poses, "period_s": 1e-3, "frequency_hz": [2.0, 20.0]}
    found = linkplan.bode("slider-crank", from_effort=["act_O"], to_position=["B"], **options)
    dead, moving = (point.responses["act_O to B"] for point in found.points)
    assert (dead.moves, dead.curve, dead.gain_at_rest) == (False, None, 0.0)
    assert not dead.measured
    assert np.abs(moving.measured.less_predicted_db).max() < 0.1
    assert found.caveats == ()
    assert "act_O to B: the effort does not move this output at 1 of 2 poses" in str(found)


def test_the_default_frequencies_start_higher_where_many_simulations_would_take_long():
    study = linkplan.bode("cart-pole", from_effort=["act_cart"], to_position=["cart"], measure=False)
    (one,) = [{name: one.transfer for name, one in point.responses.items()} for point in study.points]
    few, many = (plant_frequencies([one], Sampling(period_s=1e-3, substeps=10), rows) for rows in (1, 100))
    assert (few[0], few[-1]) == pytest.approx((few[-1] / 9 * 0.705 / 0.8038, many[-1]), rel=1e-3)
    assert many[0] > 1.5 * few[0]
    assert len(many) == len(few) == 20
