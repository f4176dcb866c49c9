"""A solution that collides far deeper than it is exact: no finer mesh frees it, and none is solved."""

import linkplan
from linkplan.planner.search.planning import SEARCH_METHODS, plan_motion

# A two-link arm that swings its hand through a post.
ARM = """<mujoco><option gravity="0 0 0"/><default><geom type="capsule" size="0.02"/></default><worldbody>
<geom name="post" type="cylinder" size="0.15 0.2" pos="0 {reach} 0"/>
<body name="upper"><joint name="a" axis="0 0 1" range="-170 170"/>
<geom fromto="0 0 0 0.4 0 0" mass="1" contype="0" conaffinity="0"/>
<body name="lower" pos="0.4 0 0"><joint name="b" axis="0 0 1" range="-20 40"/>
<geom name="hand" fromto="0.1 0 0 0.3 0 0" mass="1"/></body></body>
</worldbody><actuator><motor joint="a" ctrlrange="-50 50"/><motor joint="b" ctrlrange="-50 50"/></actuator></mujoco>"""


def planned(reach):
    problem = linkplan.Problem.reach(
        linkplan.load_mechanism(ARM.format(reach=reach)),
        start_deg={"a": 30.0, "b": 0.0},
        goal_deg={"a": 150.0, "b": 30.0},
        duration_s=1.0,
        mesh={"intervals": 20},
    )
    return plan_motion(problem, methods=SEARCH_METHODS[1:2])


def test_a_motion_through_a_post_is_not_refined():
    apart = planned(reach=5.0)
    assert apart.passed
    assert any(step.scheme != "radau-3" for step in apart.history)  # its mesh is refined
    through = planned(reach=0.6)
    assert not through.passed
    assert "collide" in through.message
    assert all(step.what.startswith("start from") for step in through.history)
