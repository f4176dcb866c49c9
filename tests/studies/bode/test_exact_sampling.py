"""The machine's own sampled loop beside that of the simulator's steps, which add damping."""

import numpy as np
import pytest

import linkplan

# An inertia of 0.05 kg m2 without friction or weight.
ROTOR = """<mujoco><option gravity="0 0 0" timestep="0.002" integrator="Euler"/><worldbody><body name="rotor">
<joint name="J" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody>
<actuator><motor name="m" joint="J" ctrlrange="-20 20"/></actuator></mujoco>"""
T, INERTIA, KP = 0.01, 0.05, 40.0


def radius_of(kd: float, delay: bool) -> float:
    """Return the spectral radius of the double integrator under held commands, in closed form."""
    A, B = np.array([[1.0, T], [0.0, 1.0]]), np.array([[T**2 / 2], [T]]) / INERTIA
    K = np.array([[KP, kd]])
    closed = np.block([[A, B], [-K, np.zeros((1, 1))]]) if delay else A - B @ K
    return float(np.abs(np.linalg.eigvals(closed)).max())


@pytest.mark.parametrize(("kd", "delay_periods"), [(0.15, 0), (0.3, 0), (0.7, 0), (0.7, 1)])
def test_the_largest_pole_of_the_machine_is_that_of_held_commands(kd, delay_periods):
    tracking = {"kp": KP, "kd": kd, "period_s": T, "delay_periods": delay_periods}
    found = linkplan.bode(linkplan.load_mechanism(ROTOR), tracking=tracking, at_deg=[0.0], measure=False)
    (point,) = found.points
    assert point.machine_spectral_radius == pytest.approx(radius_of(kd, bool(delay_periods)), rel=1e-9)


@pytest.mark.parametrize(("kd", "is_told"), [(0.17, True), (0.3, False)])
def test_a_loop_that_only_the_simulator_damps_is_told(kd, is_told):
    """The machine needs kd > kp T / 2 = 0.2; five steps of 2 ms each add kp h / 2 = 0.04."""
    tracking = {"kp": KP, "kd": kd, "period_s": T}
    found = linkplan.bode(linkplan.load_mechanism(ROTOR), tracking=tracking, at_deg=[0.0], measure=False)
    assert found.stable
    assert ("the machine itself, sampled without the damping" in found.message) is is_told
    assert ("largest pole of the machine" in str(found)) is is_told
