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
# # A design study
#
# Which motor does the knee need? The shank must swing from -49 to 56 deg. Duration, payload and motor torque depend on each
# other. A planner finds the relation without a prototype. Since it is the optimum, a slow motion shows a weak motor and not
# a poor controller.

# %%
import numpy as np
from matplotlib import pyplot as plt

import linkplan

swing = linkplan.Problem.from_file("knee-reach")
print(swing.to_toml())

# %% [markdown]
# ## Torque against time
#
# This is the least time for each motor torque. `Planner` reuses its program and starts from the last solution.

# %%
torques = [60.0, 80.0, 100.0, 130.0, 160.0, 200.0]
planner = linkplan.Planner()
quickest = swing.replace(duration_s="free", minimize="time", tracking=None)
least = []
for torque in torques:
    plan = planner.plan(quickest.replace(limits={"effort": {"act_O": [-torque, torque]}})).require()
    least.append(plan.duration_s)
    print(f"{torque:4.0f} N.m: {1000 * plan.duration_s:6.2f} ms, at most {plan.certificate.peak_motor_power[0]:.0f} W")

# %%
figure, axes = plt.subplots(figsize=(7, 3.2), layout="constrained")
axes.plot(torques, 1000 * np.array(least), "o-")
axes.set(xlabel="torque limit [N.m]", ylabel="least time of the swing [ms]")
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# With inertia alone the time would be proportional to the torque to the power -1/2. Here it nearly is, so weight and the
# linkage's ratio matter little: half the time needs four times the torque.

# %%
scaled = np.array(least) * np.sqrt(torques)
print("time x sqrt(torque), relative to the strongest motor:", np.round(scaled / scaled[-1], 3))

# %% [markdown]
# ## What a little more time is worth
#
# In its least time the motor is always at its limit. More time needs less torque and power, and heats less.

# %%
fast = least[torques.index(100.0)]
print(f"{'time':>9} {'peak torque':>12} {'peak power':>11} {'heat, relative':>15}")
heat = []
for factor in (1.05, 1.2, 1.5, 2.0):
    plan = linkplan.plan(swing.replace(duration_s=factor * fast)).require()
    heat.append(plan.objective)
    certificate = plan.certificate
    torque, power = certificate.peak_effort[0], certificate.peak_motor_power[0]
    print(f"{1000 * plan.duration_s:6.0f} ms {torque:8.1f} N.m {power:9.0f} W {plan.objective / heat[0]:15.2f}")

# %% [markdown]
# The objective is the integral of squared torque, which is proportional to a motor's copper loss.
#
# ## A payload that is not known
#
# The same swing in 0.16 s with an uncertain mass, and the torque that each mass needs:

# %%
body = {"body": "crank", "com_m": [0.0, 0.0, 0.2]}
for mass in (2.0, 3.0, 4.0):
    knee = linkplan.load_mechanism("optimus-knee", payload=body | {"mass_kg": mass})
    plan = linkplan.plan(swing.replace(mechanism=knee))
    needed = f"{plan.certificate.peak_effort[0]:.1f} N.m" if plan.certificate else plan.message
    print(f"{mass:.0f} kg at 0.2 m from O: {needed}")

# %% [markdown]
# ## Does the loop hold it?
#
# A motor that is just strong enough for the plan has no torque left for the controller. These runs follow the swing in its
# least time, and in a little more, with a payload 20 % heavier and one control period of delay:

# %%
for factor in (1.0, 1.15, 1.3):
    if factor == 1.0:
        plan = linkplan.plan(quickest.replace(tracking=swing.to_dict()["tracking"]))
    else:
        plan = linkplan.plan(swing.replace(duration_s=factor * fast))
    found = linkplan.compare(plan.require(), ["pd+ff", "lqr"]).to_dict()["mismatch"]["trackers"]
    print(f"{1000 * plan.duration_s:.0f} ms:")
    for name, run in found.items():
        print(
            f"  {name}: {run['rms_error_deg']:.2f} deg rms, {100 * run['saturated_fraction']:.0f} % of the time at the limit"
        )

# %% [markdown]
# Use the least time as a bound for the design, and plan motions with a reserve.
