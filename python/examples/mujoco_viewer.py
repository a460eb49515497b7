"""Plays an exported trajectory in MuJoCo's viewer.

    pip install ./python mujoco
    python python/examples/mujoco_viewer.py robot.urdf plan.json [--headless]

`robot.urdf` is the text `system.urdf`, and `upswing.export(plan.trajectory, "plan.json")` writes the trajectory.

The files have the names of the joints, so that any robot description of the machine will do. The links of the description have masses only:
the viewer shows lines from joint to joint. With `--headless` no window opens; the poses are computed all the same.
"""

import json
import sys
import time

import mujoco
import numpy as np


def load(urdf):
    """The robot of a URDF with capsules from each joint to the next, and the pose of the plan set from outside."""
    spec = mujoco.MjSpec.from_string(urdf)
    # Its compiler refuses inertias that miss the triangle inequality, as identified ones do by rounding. Links on fixed joints stay.
    spec.compiler.balanceinertia = True
    spec.compiler.fusestatic = False
    # Of a URDF it leaves out what does not collide.
    spec.compiler.discardvisual = False
    for body in spec.bodies[1:]:
        for end in body.bodies or ():
            if np.linalg.norm(end.pos) > 1e-3:
                line = [0, 0, 0, *end.pos]
                body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=line, size=[0.02, 0, 0], mass=0, contype=0, conaffinity=0)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.03, 0, 0], mass=0, contype=0, conaffinity=0)
    return spec.compile()


def play(model, data, plan, show=lambda: None):
    """Sets `data` to each frame of the plan, 60 per second, and calls `show`; returns the positions of the last body, (frames, 3), m."""
    address = [model.joint(joint).qposadr[0] for joint in plan["joints"]]
    t, q = np.array(plan["t"]), np.array(plan["q"])
    path = []
    for now in np.append(np.arange(0.0, plan["t_f"], 1 / 60), plan["t_f"]):
        data.qpos[address] = [np.interp(now, t, column) for column in q.T]
        data.time = now
        mujoco.mj_forward(model, data)
        path.append(data.xpos[-1].copy())
        show()
    return np.array(path)


def main():
    headless = "--headless" in sys.argv
    urdf, file = [argument for argument in sys.argv[1:] if argument != "--headless"]
    with open(urdf, encoding="utf-8") as text:
        model = load(text.read())
    with open(file, encoding="utf-8") as text:
        plan = json.load(text)
    data = mujoco.MjData(model)
    if headless:
        path = play(model, data, plan)
        print(f"{len(path)} frames, last body from {np.round(path[0], 3)} m to {np.round(path[-1], 3)} m")
        return
    # Needs a display, which the rest does not.
    from mujoco import viewer

    with viewer.launch_passive(model, data) as window:

        def show():
            window.sync()
            time.sleep(1 / 60)

        while window.is_running():
            play(model, data, plan, show)
            time.sleep(1.0)


if __name__ == "__main__":
    main()
