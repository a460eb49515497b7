# %% [markdown]
# # A crane
#
# A crane carries its load from one place to another, and the load hangs still at the end. The trajectory is written with the names of its
# joints, for other tools.
#
#     python python/examples/crane.py [FILE.csv|FILE.json|FILE.npz]

# %%
import sys

import matplotlib.pyplot as plt
import numpy as np
import upswing

path = sys.argv[1] if len(sys.argv) > 1 else "crane.csv"
system = upswing.System.load("gantry-crane")
planner = upswing.Planner(system)
plan = planner.replan([-1.0, 0.0, 0.8], "move", to={"bridge": 1.5, "trolley": 0.5, "hoist": 1.2})
trajectory = plan.trajectory
n = len(system.joints)

# %%
tips = system.model.tip(trajectory.x[:, :n])
print(f"{plan.t_f:.2f} s, from {np.round(tips[0], 3)} m to {np.round(tips[-1], 3)} m")
ropes = [system.joints.index(joint) for joint in ("sway_x", "sway_y")]
sway = np.rad2deg(trajectory.x[:, ropes])
print(f"largest sway {np.abs(sway).max():.1f} deg, at the end {np.abs(sway[-1]).max():.4f} deg")

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 3))
axes[0].plot(trajectory.t, trajectory.x[:, [system.joints.index(joint) for joint in system.actuated]], label=system.actuated)
axes[0].set(title="bridge, trolley, hoist", xlabel="t, s", ylabel="m")
axes[0].legend(fontsize=8)
axes[1].plot(trajectory.t, sway, label=["sway_x", "sway_y"])
axes[1].set(title="rope", xlabel="t, s", ylabel="deg")
axes[1].legend(fontsize=8)
figure.tight_layout()

# %% [markdown]
# The first line of the file names its columns.

# %%
upswing.export(trajectory, path)
if path.endswith(".csv"):
    with open(path) as file:
        print(file.readline(), end="")
print(path)
