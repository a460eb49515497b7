# %% [markdown]
# # The paper in a quarter of an hour
#
# The results of the paper with the package: one offline optimisation and one replan (Fig. 4), a swing-up in closed loop (Fig. 5), and planning from
# random starts (Section VI).
#
#     python python/examples/paper.py [STARTS]
#
# `STARTS` of the 10^4 random starts; 200 without.

# %%
import sys

import matplotlib.pyplot as plt
import numpy as np
import upswing

starts = int(sys.argv[1]) if len(sys.argv) > 1 else 200
system = upswing.System.load("iiwa-pendulum")
planner = upswing.Planner(system)
n_a = len(system.actuated)

# %% [markdown]
# ## Fig. 4: a plan from the database, adapted to another start
#
# The offline optimisation (6) solves the swing-up from a start pose. Online, the nearest entry of the database is adapted to the measured
# start by quadratic programs (16).

# %%
reference = upswing.optimize(system, np.deg2rad([0, 0, 0, -90, 0, 0, 0]))
print(f"offline optimisation: {reference.status}, t_F {reference.trajectory.t_f:.3f} s, cost {reference.cost:.4f}")

start = np.deg2rad([-15, -15, 0, -95, 0, 10, 0])
plan = planner.replan(start)
entry = planner.database()[plan.nearest_entry]
print(f"replan: t_F {plan.t_f:.3f} s from entry {plan.nearest_entry}, which is {plan.distance:.2f} rad away")
print(f"largest defect of the dynamics {plan.defect:.1e}, margins {({k: round(v, 3) for k, v in plan.margins.items()})}")

# %%
figure, axes = plt.subplots(1, 2, figsize=(9, 3))
for axis, columns, title in ((axes[0], range(n_a), "arm"), (axes[1], range(n_a, n_a + 2), "pendulum")):
    for i, column in enumerate(columns):
        axis.plot(entry.t, entry.x[:, column], ":", color=f"C{i}", linewidth=1)
        axis.plot(plan.trajectory.t, plan.trajectory.x[:, column], color=f"C{i}", linewidth=1, label=system.joints[column])
    axis.set(title=f"{title}: plan, and its entry (dotted)", xlabel="t, s", ylabel="q, rad")
    axis.legend(fontsize=7, ncols=2)
figure.tight_layout()

# %% [markdown]
# ## Fig. 5: the swing-up in closed loop
#
# Controller and simulated robot run cycle by cycle, 8000 times per second; the controller follows the plan with the gains of the LQR (23) and
# the torque law (24), then balances.

# %%
run = upswing.ClosedLoop(planner, np.deg2rad([0, -15, 0, -95, 0, 10, 0])).run()
recording = upswing.Recording.of(run)
limits = system.limits
print(f"closed loop: success {run.success}, {len(run)} cycles of {1e6 * system.period:.0f} us")
print(f"velocities of the arm up to {100 * np.abs(recording.qd[:, :n_a] / limits['qd_max'][:n_a]).max():.0f} % of their limits")
print(f"torques up to {100 * np.abs(recording.tau / limits['tau_max']).max():.0f} % of their limits")

# %%
figure, axes = plt.subplots(1, 3, figsize=(9, 3))
every = slice(None, None, 40)
t = recording.t[every]
axes[0].plot(t, recording.q[every, n_a:], linewidth=1, label=system.joints[n_a:])
axes[0].plot(t, recording.q_d[every, n_a:], "k:", linewidth=1)
axes[0].set(title="pendulum, and plan (dotted)", xlabel="t, s", ylabel="q, rad")
axes[0].legend(fontsize=7)
axes[1].plot(t, recording.qd[every, :n_a] / limits["qd_max"][:n_a], linewidth=1)
axes[1].set(title="velocities of the arm", xlabel="t, s", ylabel="share of the limit", ylim=(-1, 1))
axes[2].plot(t, recording.tau[every] / limits["tau_max"], linewidth=1)
axes[2].set(title="torques", xlabel="t, s", ylabel="share of the limit", ylim=(-1, 1))
figure.tight_layout()

# %% [markdown]
# The page with the robot in motion is `upswing.report(run)`, inline in a notebook.
#
# ## Section VI: plans from random starts
#
# All 10^4: `python python/examples/paper.py 10000`, or `upswing montecarlo replan`.

# %%
plans = planner.replan_all(upswing.random_starts(system, starts))
found = [plan for plan in plans if isinstance(plan, upswing.Plan)]
durations = np.array([plan.t_f for plan in found])
linearisations = np.array([plan.iterations for plan in found if plan.method == "quadratic"])
print(f"{len(found)} of {starts} random starts planned, {len(linearisations)} of them by quadratic programs alone")
print(f"t_F {durations.min():.2f} to {durations.max():.2f} s, linearisations {np.median(linearisations):.0f} (median)")

# %%
figure, axis = plt.subplots(figsize=(9, 2.5))
axis.hist(durations, bins=30)
axis.set(title="durations of the plans", xlabel="t_F, s", ylabel="starts")
figure.tight_layout()
