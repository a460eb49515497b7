"""Compares a controller and a plan of your own with ours: same starts, same plants, same criteria.

    python python/examples/own_controller.py [STARTS]

The controller is an example: joint-space PD control of the arm's part of the plan, without feedback of the pendulum. It tracks the plan and loses the balance.
"""

import sys

import numpy as np
import upswing


def pd_controller(system, plan, kp=400.0, kd=40.0):
    """u = u_d + kp (q_A,d - q_A) + kd (qd_A,d - qd_A), and the torque law (24)."""
    n = len(system.joints)
    actuated = [system.joints.index(joint) for joint in system.actuated]

    def controller(t, x, x_d, u_d):
        error = x_d - x
        u = u_d + kp * error[:n][actuated] + kd * error[n:][actuated]
        return system.model.torque(x, u)

    return controller


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    system = upswing.System.load("cart-pole")
    planner = upswing.Planner(system)
    for condition in ("nominal", "everyday"):
        plant = system if condition == "nominal" else system.with_scenario(condition)
        succeeded = {"ours": 0, "ours with r = 1/2": 0, "PD": 0}
        for index, start in enumerate(upswing.random_starts(system, count)):
            plan = planner.replan(start)
            softer = upswing.Plan(plan.trajectory, *upswing.lqr(plan.trajectory, r=0.5))
            loop = upswing.ClosedLoop(planner, start, plant=plant, seed=index)
            succeeded["ours"] += loop.run(plan=plan).success
            succeeded["ours with r = 1/2"] += loop.run(plan=softer).success
            succeeded["PD"] += loop.run(plan=plan, controller=pd_controller(system, plan)).success
        print(f"{condition}: " + ", ".join(f"{name} {n} of {count}" for name, n in succeeded.items()))


if __name__ == "__main__":
    main()
