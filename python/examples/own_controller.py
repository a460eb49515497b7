# %% [markdown]
# # Your own controller and plans beside ours
#
# Same starts, same plants, same criteria: the success of a controller of your own, and of plans with gains of your own, beside ours.
#
#     python python/examples/own_controller.py [STARTS]

# %%
import sys

import matplotlib.pyplot as plt
import numpy as np
import upswing
from upswing.benchmark import Benchmark, table

starts = int(sys.argv[1]) if len(sys.argv) > 1 else 10
system = upswing.System.load("cart-pole")
planner = upswing.Planner(system)
benchmark = Benchmark(system, samples=starts, conditions=["nominal", "everyday"])
n = len(system.joints)
actuated = [system.joints.index(joint) for joint in system.actuated]

# %% [markdown]
# A controller is a function of the time, the estimated state and the reference; it returns the torques of the motors. This one is an
# example: PD control of the cart along the plan. It tracks the plan, and loses the balance.


# %%
def pd_controller(plan, kp=400.0, kd=40.0):
    """u = u_d + kp (q_A,d - q_A) + kd (qd_A,d - qd_A), and the torque law (24)."""

    def controller(t, x, x_d, u_d):
        error = x_d - x
        u = u_d + kp * error[:n][actuated] + kd * error[n:][actuated]
        return system.model.torque(x, u)

    return controller


# %% [markdown]
# This one is our law without our disturbance observer: it balances the model, but not a plant with friction.


# %%
def our_law(plan):
    return lambda t, x, x_d, u_d: system.model.torque(x, plan.input(t, x))


def softer(start):
    """Our trajectory with softer gains, which our controller follows."""
    trajectory = planner.replan(start).trajectory
    return upswing.Plan(trajectory, *upswing.lqr(trajectory, r=0.5))


# %%
scores = [
    benchmark.score("ours", planner),
    benchmark.score("our plans, gains with r = 1/2", planner, plan=softer),
    benchmark.score("our law in Python", planner, controller=our_law),
    benchmark.score("our plans, PD controller", planner, controller=pd_controller),
]
print(table(scores))

# %% [markdown]
# `benchmark.export("benchmark.json")` keeps the starts and conditions for others; `score.to_json()` has each run. One run in detail:

# %%
plan = planner.replan(benchmark.starts[0])
loop = upswing.ClosedLoop(planner, benchmark.starts[0])
figure, axis = plt.subplots(figsize=(9, 3))
for name, controller in (("ours", None), ("PD controller", pd_controller(plan))):
    recording = upswing.Recording.of(loop.run(2.0, plan=plan, controller=controller))
    axis.plot(recording.t[::40], np.rad2deg(recording.q[::40, n - 1]), linewidth=1, label=name)
axis.set(title="pole", xlabel="t, s", ylabel="deg")
axis.legend(fontsize=8)
figure.tight_layout()
