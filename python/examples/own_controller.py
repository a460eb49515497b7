"""Compares a controller and a plan of your own with ours: same starts, same plants, same criteria.

    python python/examples/own_controller.py [STARTS]

The controller is an example: PD control of the actuated joints along the plan. It tracks the plan, and loses the balance.
"""

import sys

import upswing
from upswing.benchmark import Benchmark, table


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
    benchmark = Benchmark(system, samples=count)

    def softer(start):
        trajectory = planner.replan(start).trajectory
        return upswing.Plan(trajectory, *upswing.lqr(trajectory, r=0.5))

    scores = [
        benchmark.score("ours", planner),
        benchmark.score("our plans, gains with r = 1/2", planner, plan=softer),
        benchmark.score("our plans, PD controller", planner, controller=lambda plan: pd_controller(system, plan)),
    ]
    print(table(scores))


if __name__ == "__main__":
    main()
