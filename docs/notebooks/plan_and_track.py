# ---
# jupyter:
#   jupytext:
#     text_representation:
#       format_name: percent
#   kernelspec:
#     name: python3
#     display_name: Python 3
# ---

# %% [markdown]
# # Plan and track
#
# This page plans and tracks your own crank-rocker in Python: its model as text, a problem, a plan with its certificate, a
# tracker of ten lines, and the margins of the feedback loop. `docs/notebooks/plan_and_track.py` is the page as a Python
# file, which you can run directly; `plan_and_track.ipynb` is the executed notebook.

# %%
import numpy as np
from matplotlib import pyplot as plt

import linkplan

plt.switch_backend(plt.get_backend())  # now, so that figures stand in the page from the first on

# %% [markdown]
# ## The mechanism
#
# The crank has 50 mm, the frame 200 mm. A motor drives O; A and C are the other hinges. A `connect` closes the pin B.

# %%
MODEL = """
<mujoco model="crank-rocker">
  <option timestep="2e-4"/>
  <default>
    <joint axis="0 1 0" damping="0.002"/>
    <geom type="capsule" size="0.008" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="crank">
      <joint name="O"/>
      <geom fromto="0 0 0 0 0 0.05"/>
      <body name="coupler" pos="0 0 0.05">
        <joint name="A"/>
        <geom fromto="0 0 0 0.16 0 0.07"/>
      </body>
    </body>
    <body name="rocker" pos="0.2 0 0">
      <joint name="C"/>
      <geom fromto="0 0 0 -0.04 0 0.12"/>
    </body>
  </worldbody>
  <equality>
    <connect name="B" body1="coupler" body2="rocker" anchor="0.16 0 0.07"/>
  </equality>
  <actuator>
    <motor name="drive" joint="O" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""
linkage = linkplan.load_mechanism(MODEL, solref="stiff")
found = linkplan.check(linkage)
print(found.problems or "no problems")
found.plot()

# %% [markdown]
# ## The problem and its plan
#
# The crank makes half a turn in 0.3 s, at rest at both ends. The rocker's speed is limited to 600 deg/s.

# %%
problem = linkplan.Problem.reach(
    linkage,
    start_deg={"O": 0.0},
    goal_deg={"O": 180.0},
    duration_s=0.3,
    limits={"effort": {"drive": [-1.0, 1.0]}, "speed_deg_s": {"C": 600.0}},
    tracking={"kp": 5.0, "kd": 0.03, "period_s": 5e-4},
    name="half-turn",
)
plan = linkplan.plan(problem).require()
print(plan)
plan.plot()

# %% [markdown]
# What is the least time of the half turn with a fifth of the torque? `replace` returns a changed problem.

# %%
weak = {"effort": {"drive": [-0.2, 0.2]}}
quick = linkplan.plan(problem.replace(limits=weak, duration_s="free", minimize="time")).require()
fastest = np.abs(quick.sample().speed_deg_s["C"]).max()
print(f"{1000 * quick.duration_s:.1f} ms; the rocker turns at no more than {fastest:.0f} deg/s")

# %% [markdown]
# ## A tracker of one's own
#
# A tracker has a name and a law. This one adds feedback, with gains chosen by hand, to the plan's torque.


# %%
class ByHand:
    """The plan's torque, and feedback of position and speed."""

    name = "by hand"

    def __init__(self, reference):
        self.reference = reference

    def effort(self, k, position_rad, velocity_rad_s):
        """Return the torque at control instant k."""
        error = self.reference.position_rad[k] - position_rad
        rate = self.reference.velocity_rad_s[k] - velocity_rad_s
        return self.reference.effort[k] + 4.0 * error + 0.01 * rate


print(linkplan.compare(plan, ["pd", ByHand, "pd+ff", "lqr"]))

# %% [markdown]
# The runs are arrays in SI units, with one row per control instant.

# %%
runs = linkplan.compare(plan, [ByHand, "pd+ff", "lqr"]).mismatched
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for (name, run), line in zip(runs.items(), ("-", "--", ":"), strict=True):
    error = np.degrees(run.position_rad - run.reference_rad)[:, 0]
    axes.plot(plan.problem.tracking.period_s * np.arange(len(error)), error, line, label=name)
axes.set(xlabel="time [s]", ylabel="error of O [deg]", title="20 % more mass, one control period of delay")
axes.legend()
plt.show()

# %% [markdown]
# ## The loop's margins

# %%
gains = linkplan.tune(problem, bandwidth_hz=10.0)
print(gains.message)
loop = linkplan.bode(problem.replace(tracking=gains.tracking), at_deg=[{"O": 90.0}], frequency_hz=[10.0, 50.0])
print(loop.message)
