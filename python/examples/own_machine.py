# %% [markdown]
# # Your own machine: from a URDF to the first swing-up
#
# `upswing system new` writes the settings of a chain of joints in a URDF; Python plans and simulates with them. The machine of this page is a
# pendulum on a rotating arm, of two joints.
#
#     python python/examples/own_machine.py

# %%
import os
import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import upswing

folder = Path(tempfile.mkdtemp())
urdf = """<robot name="rotary_pendulum">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="0.25"/>
    <inertia ixx="1e-5" ixy="0" ixz="0" iyy="9e-4" iyz="0" izz="9e-4"/></inertial></link>
  <link name="rod"><inertial><origin xyz="0 0 -0.15"/><mass value="0.1"/>
    <inertia ixx="8e-4" ixy="0" ixz="0" iyy="8e-4" iyz="0" izz="1e-5"/></inertial></link>
  <link name="rod_tip"/>
  <joint name="motor" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="15" effort="0.8"/></joint>
  <joint name="pole" type="continuous"><parent link="arm"/><child link="rod"/><origin xyz="0.2 0 0"/><axis xyz="1 0 0"/>
    <limit velocity="30" effort="0"/></joint>
  <joint name="end" type="fixed"><parent link="rod"/><child link="rod_tip"/><origin xyz="0 0 -0.3"/></joint>
</robot>"""
(folder / "robot.urdf").write_text(urdf)

# %% [markdown]
# The command line writes the settings, with a comment for each value, and says what is left to decide.

# %%
upswing_program = os.environ.get("UPSWING", "upswing")
command = [upswing_program, "system", "new", str(folder / "machine"), "--urdf", str(folder / "robot.urdf")]
done = subprocess.run(command, capture_output=True, text=True)
print((done.stdout + done.stderr).replace(str(folder), "FOLDER"))

# %%
system = upswing.System.load(folder / "machine")
print(system.joints, system.actuated, system.manoeuvres)

optimum = upswing.optimize(system, [0.0], best=True)
print(f"{optimum.status}, t_F {optimum.trajectory.t_f:.3f} s, margins {({k: round(v, 3) for k, v in optimum.margins.items()})}")

# %% [markdown]
# The multipliers say which limits make the swing-up as expensive as it is: by how much the cost (6a), s, falls per unit of a limit.

# %%
pull = np.abs(optimum.multipliers["x"][:, len(system.joints) :]).sum(axis=0)
for joint, limit, each in zip(system.joints, system.planning_limits["qd_max"], pull):
    print(f"velocity of {joint}: limit {limit:.1f} rad/s, {each:.1e} s per rad/s")
torque = np.abs(optimum.multipliers["torque"]).sum()
print(f"torque of the motor: limit {system.planning_limits['tau_max'][0]:.1f} N m, {torque:.1e} s per N m")

# %% [markdown]
# The planner needs no database to begin with: it optimises each plan in full. `upswing.build_database` makes one.

# %%
planner = upswing.Planner(system)
run = upswing.ClosedLoop(planner, [0.0]).run()
print(f"closed loop: success {run.success} {run.failures}")
recording = upswing.Recording.of(run)
figure, axis = plt.subplots(figsize=(9, 3))
axis.plot(recording.t[::40], np.rad2deg(recording.q[::40]), linewidth=1, label=recording.joints)
axis.set(title="the first swing-up", xlabel="t, s", ylabel="deg")
axis.legend(fontsize=8)
figure.tight_layout()
