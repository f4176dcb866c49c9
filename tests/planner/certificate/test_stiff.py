"""The certificate of a motion whose damping acts within microseconds."""

from linkplan.planner.certificate import integration
from linkplan.planner.certificate.certificate import certify
from tests.support.bodies import QUARTER_TURN, body_plan

# Inertia over damping is 10 us. The motion takes 1.5 s.
DAMPED = """<mujoco><option gravity="0 0 0"/><worldbody><body name="finger"><joint name="J" axis="0 1 0" damping="1"/>
<inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/></body></worldbody>
<actuator><motor name="motor" joint="J" ctrlrange="-4 4"/></actuator></mujoco>"""


def test_a_stiff_motion_is_integrated_by_an_implicit_method_after_one_explicit_attempt(monkeypatch):
    plan = body_plan(DAMPED, QUARTER_TURN + "duration_s = 1.5\n")
    assert plan.status == "optimal", plan.message
    counts, called = [], integration.called

    def counting(*given):
        rate = called(*given)
        counts.append(0)

        def counted(t, y):
            counts[-1] += 1
            return rate(t, y)

        return counted

    monkeypatch.setattr(integration, "called", counting)
    certificate = certify(plan.problem, plan.trajectory)
    assert certificate.passed
    assert max(counts) < 2_400  # 2,000 explicit ones at the most; explicit steps alone take up to 7,200
