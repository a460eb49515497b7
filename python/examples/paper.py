"""The paper's results in some minutes: one optimisation and one replan (Fig. 4), a run in closed loop (Fig. 5), and planning from random starts
(Section VI; the paper takes 10^4 of them).

    python python/examples/paper.py [STARTS]
"""

import sys

import numpy as np
import upswing


def main():
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    system = upswing.System.load("iiwa-pendulum")
    planner = upswing.Planner(system)

    reference = upswing.optimize(system, np.deg2rad([0, 0, 0, -90, 0, 0, 0]))
    print(f"offline optimisation: {reference.status}, t_F {reference.trajectory.t_f:.3f} s, cost {reference.cost:.4f}")

    start = np.deg2rad([-15, -15, 0, -95, 0, 10, 0])
    plan = planner.replan(start)
    away = np.abs(plan.trajectory.x - planner.database()[plan.nearest_entry].x).max()
    print(
        f"replan: t_F {plan.t_f:.3f} s from entry {plan.nearest_entry} ({plan.distance:.2f} rad away), at most {away:.2f} from it, "
        f"{1e3 * plan.times['total']:.0f} ms"
    )

    run = upswing.ClosedLoop(planner, np.deg2rad([0, -15, 0, -95, 0, 10, 0])).run()
    recording = upswing.Recording.of(run)
    limits = system.limits
    print(
        f"closed loop: success {run.success}, {len(run)} cycles, velocities up to "
        f"{100 * np.abs(recording.qd[:, :7] / limits['qd_max'][:7]).max():.0f} %, torques up to "
        f"{100 * np.abs(recording.tau / limits['tau_max']).max():.0f} % of their limits"
    )
    upswing.report(run).save("swing-up.html")

    plans = planner.replan_all(upswing.random_starts(system, samples))
    found = [plan for plan in plans if isinstance(plan, upswing.Plan)]
    milliseconds = 1e3 * np.array([plan.times["total"] for plan in found])
    print(f"{len(found)} of {samples} random starts planned, median {np.median(milliseconds):.0f} ms")


if __name__ == "__main__":
    main()
