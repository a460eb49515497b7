"""Takes the place of upswing-plant: the robot of a URDF in MuJoCo, behind the same channels.

    python mujoco_plant.py --system my-config --domain upswing

The settings are those of `upswing config export my-config`. Clock `paced`: one period per command, not faster than real
time; MuJoCo with Python takes about as long as real time, so that a run may take longer than its simulated time. Drives
are ideal; of the friction only that of the pendulum's bearings is there. The `plant` service (faults, pushes) is not.
"""

import argparse
import signal
import sys
import time
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import upswing_layouts as layouts
from upswing_ipc import Node, Refused
from upswing_layouts import Clock, Command, Measurement

# Silence after which a daemon counts as lost, and how often one is looked for.
LOST_AFTER_S = 1.0
SEARCH_PERIOD_S = 0.1


def load(urdf):
    """The URDF as a MuJoCo model without contacts and joint stops: whether limits are kept is what the daemon watches."""
    spec = mujoco.MjSpec.from_file(str(urdf))
    for body in spec.bodies:
        # Identified inertias are rounded and may miss the triangle inequality by that, which MuJoCo refuses: the
        # largest principal moment becomes the sum of the others then.
        xx, yy, zz, xy, xz, yz = body.fullinertia
        if not np.isfinite(body.fullinertia).all():
            continue
        moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        moments[2] = min(moments[2], (1 - 1e-9) * (moments[0] + moments[1]))
        xx, xy, xz, _, yy, yz, _, _, zz = (axes @ np.diag(moments) @ axes.T).ravel()
        body.fullinertia = [xx, yy, zz, xy, xz, yz]
    model = spec.compile()
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    return model


def unactuated_joints(urdf):
    """Names of the joints without a motor: those with effort="0", or without an effort."""
    joints = ElementTree.parse(urdf).getroot().findall("joint")
    limits = {joint.get("name"): joint.find("limit") for joint in joints}
    return {name for name, limit in limits.items() if limit is None or float(limit.get("effort", 0)) == 0}


def per_joint(value, names):
    """A setting that is one number for all joints, or a table of joint names with a default."""
    if isinstance(value, dict):
        return np.array([value[name] if name in value else value["default"] for name in names], dtype=float)
    return np.full(len(names), float(value))


class Plant:
    """Robot and pendulum; brakes as in upswing-plant."""

    def __init__(self, config):
        settings = tomllib.loads((config / "plant.toml").read_text(encoding="utf-8"))
        daemon = tomllib.loads((config / "daemon.toml").read_text(encoding="utf-8"))
        robot = tomllib.loads((config / "robot.toml").read_text(encoding="utf-8"))
        urdf = config / settings["model"]["urdf"]
        self.model = load(urdf)
        if (self.model.jnt_type != mujoco.mjtJoint.mjJNT_HINGE).any():
            raise ValueError(f"{urdf}: expected revolute joints only")
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        without_motor = unactuated_joints(urdf)
        # The index sets A and U; payloads have the order of the chain, as MuJoCo.
        self.actuated = np.array([i for i, name in enumerate(names) if name not in without_motor])
        self.unactuated = np.array([i for i, name in enumerate(names) if name in without_motor])
        actuated, unactuated = ([names[i] for i in indices] for indices in (self.actuated, self.unactuated))
        if not 0 < len(unactuated) < len(names) <= layouts.MOST_JOINTS:
            raise ValueError(f"{urdf}: expected 2 to {layouts.MOST_JOINTS} joints, some of them with a motor and some without")
        self.period_ns = daemon["cycle"]["period_us"] * 1000
        self.model.opt.timestep = self.period_ns * 1e-9
        self.model.dof_damping[self.unactuated] = per_joint(settings["friction"]["pendulum_viscous"], unactuated)
        self.model.dof_frictionloss[self.unactuated] = per_joint(settings["friction"]["pendulum_coulomb"], unactuated)
        self.brake_time_constant = settings["drive"]["brake_time_constant_ms"] * 1e-3
        self.tau_max = per_joint(robot["limits"]["tau_nm"], actuated)
        encoder = settings["encoder"]
        self.grid = np.empty(len(names))
        self.grid[self.actuated] = per_joint(encoder["arm_resolution_rad"], actuated)
        self.grid[self.unactuated] = 2 * np.pi / 2 ** per_joint(encoder["pendulum_bits"], unactuated)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[self.actuated] = np.radians(per_joint(settings["start"]["q_deg"], actuated))
        self._hang()
        self.tau = np.zeros(len(actuated))
        self.braking, self.fault, self.saturated = True, False, False
        self.seq = 1

    @property
    def sizes(self):
        """Numbers of joints and of actuated joints."""
        return len(self.grid), len(self.tau)

    def _hang(self):
        """Newton's method: the pendulum at rest under the arm."""
        data, free = self.data, self.unactuated
        for _ in range(50):
            mujoco.mj_forward(self.model, data)
            gravity, step = data.qfrc_bias[free].copy(), 1e-6
            slope = np.empty((len(free), len(free)))
            for column, i in enumerate(free):
                data.qpos[i] += step
                mujoco.mj_forward(self.model, data)
                slope[:, column] = (data.qfrc_bias[free] - gravity) / step
                data.qpos[i] -= step
            data.qpos[free] -= np.linalg.solve(slope, gravity)
        if np.abs(gravity).max() > 1e-6:
            raise ValueError("start.q_deg of plant.toml: the pendulum has no rest there")

    def _brake_torque(self):
        """Of u = -qd_A / time constant: the rows of the arm of (1), with qdd_U from those of the pendulum."""
        model, data = self.model, self.data
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        h = data.qfrc_bias - data.qfrc_passive - data.qfrc_constraint
        A, U = self.actuated, self.unactuated
        u = -data.qvel[A] / self.brake_time_constant
        qdd_u = -np.linalg.solve(mass[np.ix_(U, U)], mass[np.ix_(U, A)] @ u + h[U])
        return mass[np.ix_(A, A)] @ u + mass[np.ix_(A, U)] @ qdd_u + h[A]

    def step(self, command):
        """One period under a command; None: the brakes are closed."""
        self.saturated = False
        if command is not None:
            tau = np.array(command.tau[: len(self.tau)])
            if not np.isfinite(tau).all():
                self.fault = True
            elif command.brake:
                self.fault = False
        self.braking = command is None or self.fault or command.brake != 0
        if self.braking:
            self.tau[:] = 0
            self.data.qfrc_applied[self.actuated] = self._brake_torque()
        else:
            self.saturated = bool((np.abs(tau) > self.tau_max).any())
            self.tau = np.clip(tau, -self.tau_max, self.tau_max)
            self.data.qfrc_applied[self.actuated] = self.tau
        mujoco.mj_step(self.model, self.data)
        self.seq += 1

    def measure(self):
        """What encoders and drives report."""
        status = layouts.DRIVE_FAULT if self.fault else layouts.DRIVES_READY
        status |= layouts.BRAKES_CLOSED if self.braking else 0
        status |= layouts.SATURATED if self.saturated else 0
        measurement = Measurement(seq=self.seq, t_ns=self.seq * self.period_ns, status=status)
        measurement.clock, measurement.period_ns = Clock.Paced, self.period_ns
        measurement.joints, measurement.actuated = self.sizes
        measurement.q[: len(self.grid)] = (np.round(self.data.qpos / self.grid) * self.grid).tolist()
        measurement.tau_measured[: len(self.tau)] = self.tau.tolist()
        return measurement


class Daemon:
    """The commands of the newest daemon; `sizes` are the numbers of joints that it must have."""

    def __init__(self, node, sizes):
        self.node, self.sizes, self.reader, self.seq = node, sizes, None, 0
        self.searched = -SEARCH_PERIOD_S

    def search(self):
        now = time.monotonic()
        if now - self.searched < SEARCH_PERIOD_S:
            return
        self.searched = now
        reader = self.node.newest_reader(layouts.COMMAND_CHANNEL, Command, than=self.reader)
        if reader is not None:
            self.reader, self.seq = reader, 0

    def take(self, newest):
        """A command that was not taken before and answers one of the measurements 1..=newest."""
        command = self.reader.take() if self.reader is not None else None
        if command is None or command.seq <= self.seq or not 1 <= command.measurement_seq <= newest:
            return None
        if (got := (command.joints, command.actuated)) != self.sizes:
            raise Refused(f"command for (joints, actuated) = {got}, expected {self.sizes}: daemon and plant have other robots")
        self.seq = command.seq
        return command


def run(plant, node, going):
    """Publishes measurement n, waits for the command that answers it, advances one period."""
    writer = node.writer(layouts.MEASUREMENT_CHANNEL, Measurement)
    daemon = Daemon(node, plant.sizes)
    period = plant.period_ns * 1e-9
    deadline = time.monotonic()
    present = False
    while going():
        writer.write(plant.measure())
        command = None
        if present:
            lost = time.monotonic() + LOST_AFTER_S
            while going() and command is None and time.monotonic() < lost:
                command = daemon.take(plant.seq)
                if command is not None and command.measurement_seq != plant.seq:
                    command = None
            present = command is not None
            if not present and going():
                print(f"daemon lost in cycle {plant.seq}", file=sys.stderr)
        else:
            daemon.search()
            present = daemon.take(plant.seq) is not None
            if present:
                print(f"daemon found in cycle {plant.seq}", file=sys.stderr)
        plant.step(command)
        deadline = max(deadline + period, time.monotonic())
        while (left := deadline - time.monotonic()) > 0:
            time.sleep(left)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--system", type=Path, required=True, metavar="DIR", help="folder of upswing config export")
    parser.add_argument("--domain", default="upswing")
    args = parser.parse_args()
    stop = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    plant = Plant(args.system)
    print(f"MuJoCo {mujoco.__version__}, q = {np.degrees(plant.data.qpos).round(2).tolist()} deg", file=sys.stderr)
    run(plant, Node(args.domain, "mujoco plant"), lambda: not stop)


if __name__ == "__main__":
    main()
