"""A crane carries its load from one place to another, and the load hangs still at the end; the trajectory is written with the names of its joints.

    python python/examples/crane.py [FILE.csv|FILE.json|FILE.npz]
"""

import sys

import numpy as np
import upswing


def main():
    system = upswing.System.load("gantry-crane")
    planner = upswing.Planner(system)
    start = [-1.0, 0.0, 0.8]
    plan = planner.replan(start, "move", to={"bridge": 1.5, "trolley": 0.5, "hoist": 1.2})
    tips = system.model.tip(plan.trajectory.x[:, : len(system.joints)])
    print(f"{plan.t_f:.2f} s, from {np.round(tips[0], 3)} m to {np.round(tips[-1], 3)} m")
    sway = plan.trajectory.x[:, [system.joints.index(joint) for joint in ("sway_x", "sway_y")]]
    print(f"largest sway {np.rad2deg(np.abs(sway).max()):.1f} deg, at the end {np.rad2deg(np.abs(sway[-1]).max()):.4f} deg")
    path = sys.argv[1] if len(sys.argv) > 1 else "crane.csv"
    upswing.export(plan.trajectory, path)
    print(path)


if __name__ == "__main__":
    main()
