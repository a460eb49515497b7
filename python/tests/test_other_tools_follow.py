"""Exported trajectories, read by their names of joints, are motions of the same robot in other tools."""

import csv
import json

import numpy as np
import pytest
import upswing
from conftest import ARM_START_DEG


@pytest.fixture(scope="module")
def plan(arm_planner):
    return arm_planner.replan(np.deg2rad(ARM_START_DEG))


def test_files_keep_all_digits(plan, tmp_path):
    trajectory = plan.trajectory
    q, qd = np.split(trajectory.x, 2, axis=1)
    upswing.export(trajectory, tmp_path / "plan.json")
    document = json.loads((tmp_path / "plan.json").read_text())
    assert document["joints"] == trajectory.joints and document["q"] == q.tolist()
    upswing.export(trajectory, tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz") as arrays:
        assert arrays["qd"].tolist() == qd.tolist() and arrays["actuated"].tolist() == trajectory.actuated
    times = np.linspace(0, trajectory.t_f, 7)
    upswing.export(trajectory, tmp_path / "plan.csv", times)
    with open(tmp_path / "plan.csv") as file:
        rows = list(csv.DictReader(file))
    joint = trajectory.joints[2]
    assert [float(row[f"q_{joint}"]) for row in rows] == trajectory.state(times)[:, 2].tolist()
    with pytest.raises(upswing.InputError, match="expected a name that ends in"):
        upswing.export(trajectory, tmp_path / "plan.txt")


def follow(plan, derivative, joints):
    """Distance (rad or rad/s) at each knot between the plan and the motion that another tool computes from the knot before it, by the classical
    Runge-Kutta method. `derivative(x, u)` has the order of `joints`."""
    trajectory = plan.trajectory
    n = len(joints)
    order = [trajectory.joints.index(joint) for joint in joints]
    order = order + [n + i for i in order]
    x, u, h = trajectory.x[:, order], trajectory.u, trajectory.t_f / (len(trajectory) - 1)
    away = []
    for k in range(len(x) - 1):
        state, steps = x[k], 4
        for i in range(steps):
            dt = h / steps
            at = lambda s: u[k] + (u[k + 1] - u[k]) * (i + s) / steps  # noqa: E731
            k1 = derivative(state, at(0.0))
            k2 = derivative(state + dt / 2 * k1, at(0.5))
            k3 = derivative(state + dt / 2 * k2, at(0.5))
            k4 = derivative(state + dt * k3, at(1.0))
            state = state + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        away.append(np.abs(state - x[k + 1]).max())
    return np.array(away)


def unactuated_from(mass, effects, actuated):
    """qdd of all joints for given qdd_A: the rows of (1) without torque."""
    free = ~actuated

    def qdd(u):
        result = np.zeros(len(actuated))
        result[actuated] = u
        result[free] = np.linalg.solve(mass[np.ix_(free, free)], -(effects[free] + mass[np.ix_(free, actuated)] @ u))
        return result

    return qdd


# What the trapezoidal rule leaves in one interval of a plan, rad or rad/s: 0.003 with the dynamics of upswing itself.
ALLOWED = 5e-3
# The same integration with dynamics that differ by rounding, which an interval of 0.02 s hardly amplifies.
ROUNDING = 1e-9


def check(arm, plan, derivative, names):
    ours = follow(plan, arm.model.f, arm.joints)
    theirs = follow(plan, derivative, names)
    assert theirs.max() < ALLOWED
    assert np.abs(theirs - ours).max() < ROUNDING


def test_pinocchio_follows(arm, plan, tmp_path):
    pin = pytest.importorskip("pinocchio")
    path = tmp_path / "robot.urdf"
    path.write_text(arm.urdf)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    names = [name for name in model.names if name != "universe"]
    n, actuated = len(names), np.array([name in arm.actuated for name in names])

    def derivative(x, u):
        mass = pin.crba(model, data, x[:n])
        mass = np.triu(mass) + np.triu(mass, 1).T
        effects = pin.nle(model, data, x[:n], x[n:])
        return np.concatenate([x[n:], unactuated_from(mass, effects, actuated)(u)])

    check(arm, plan, derivative, names)
    x = plan.trajectory.x[50]
    order = [arm.joints.index(name) for name in names]
    mass = pin.crba(model, data, x[:n][order])
    assert np.allclose(np.triu(mass), np.triu(arm.model.mass_matrix(x[:n])[np.ix_(order, order)]), atol=1e-12)


def test_mujoco_follows(arm, plan):
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_string(arm.urdf)
    # Its compiler refuses inertias that miss the triangle inequality, as identified ones do by rounding.
    spec.compiler.balanceinertia = True
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.gravity[:] = [0, 0, -9.81]
    data = mujoco.MjData(model)
    names = [model.joint(i).name for i in range(model.njnt)]
    n, actuated = len(names), np.array([name in arm.actuated for name in names])

    def derivative(x, u):
        data.qpos[:], data.qvel[:] = x[:n], x[n:]
        mujoco.mj_forward(model, data)
        mass = np.zeros((n, n))
        mujoco.mj_fullM(model, data, mass)
        return np.concatenate([x[n:], unactuated_from(mass, data.qfrc_bias.copy(), actuated)(u)])

    check(arm, plan, derivative, names)
