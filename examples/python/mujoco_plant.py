"""Takes the place of upswing-plant: the robot of a system's URDF in MuJoCo, behind the same channels.

    python mujoco_plant.py --system cart-pole --domain upswing

Clock `paced`: one period per command, not faster than real time; where a step takes longer than a period, a run takes
longer than its simulated time. The bodies are MuJoCo's; friction, stops, brakes and encoders obey the equations and settings of
upswing-plant. Drives are ideal, and there is no noise; the `plant` service (faults, pushes) is not there.
"""

import argparse
import signal
import sys
import time

import mujoco
import numpy as np
import upswing_layouts as layouts
from upswing_ipc import Node, Refused
from upswing_layouts import Clock, Command, Measurement
from upswing_settings import Settings, add_system_options

# Silence after which a daemon counts as lost if its process has ended, and if it lives: as in upswing-plant.
LOST_AFTER_S = 1.0, 20.0
# How often a daemon is looked for.
SEARCH_PERIOD_S = 0.1
# A wait of this time spins, a longer one naps.
SPIN_S, NAP_S = 100e-6, 20e-6


def load(urdf):
    """The chain of a URDF as a MuJoCo model, with the inertias of the URDF; without contacts, joint limits and friction."""
    spec = mujoco.MjSpec.from_string(urdf)
    # Links on fixed joints stay bodies of their own, so that each body has the inertia of its link.
    spec.compiler.fusestatic = False
    largest = {}
    for body in spec.bodies:
        # Rounded inertias may miss the triangle inequality, which MuJoCo's compiler refuses. It gets a smaller largest
        # moment, and the model the true one afterwards: the equations of motion need no triangle inequality.
        if not np.isfinite(body.fullinertia).all():
            continue
        xx, yy, zz, xy, xz, yz = body.fullinertia
        moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[2] > moments[0] + moments[1]:
            largest[body.name] = moments[2]
            moments[2] = (1 - 1e-9) * (moments[0] + moments[1])
            xx, xy, xz, _, yy, yz, _, _, zz = (axes @ np.diag(moments) @ axes.T).ravel()
            body.fullinertia = [xx, yy, zz, xy, xz, yz]
    model = spec.compile()
    for name, moment in largest.items():
        inertia = model.body(name).inertia
        inertia[inertia.argmax()] = moment
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    model.opt.gravity = 0, 0, -9.81
    model.dof_damping[:], model.dof_frictionloss[:], model.dof_armature[:] = 0, 0, 0
    # Fourth order: in periods of 125 us its error is far below the encoders' resolution, as that of upswing-plant.
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    return model


class Plant:
    """Robot and pendulum at rest in the start pose of the settings; brakes as in upswing-plant."""

    def __init__(self, settings):
        plant, names = settings.plant, [joint.name for joint in settings.joints]
        self.model = model = load(settings.urdf)
        if (got := [model.joint(i).name for i in range(model.njnt)]) != names or model.nv != len(names):
            raise ValueError(f"expected the joints {', '.join(names)}, got {', '.join(got)}")
        actuated = np.array([joint.actuated for joint in settings.joints])
        # The index sets A and U; payloads have the order of the chain, as MuJoCo.
        self.actuated, self.unactuated = np.flatnonzero(actuated), np.flatnonzero(~actuated)
        if not 0 < actuated.sum() < len(names) <= layouts.MOST_JOINTS:
            raise ValueError(f"expected 2 to {layouts.MOST_JOINTS} joints, some with a motor and some without: {', '.join(names)}")
        by_kind = lambda arm, pendulum: np.where(actuated, settings.numbers(arm), settings.numbers(pendulum))
        self.period_ns = settings.period_ns
        model.opt.timestep = self.period_ns * 1e-9
        friction, stops = plant["friction"], plant["stops"]
        left = np.where(actuated, 1 - friction["compensation"], 1)
        model.dof_damping[:] = left * settings.numbers(friction["viscous"])
        self.coulomb = left * settings.numbers(friction["coulomb"])
        self.smoothing = friction["coulomb_smoothing_rad_s"]
        model.dof_armature[:] = by_kind(plant["model"]["rotor_inertia_kg_m2"], 0)
        self.stiffness, self.damping = settings.numbers(stops["stiffness"]), settings.numbers(stops["damping"])
        self.stop_range = settings.positions(settings.robot["limits"], "q").T + np.outer([-1, 1], settings.positions(stops, "margin"))
        self.brake_time_constant = plant["drive"]["brake_time_constant_ms"] * 1e-3
        self.tau_max = settings.numbers(settings.robot["limits"]["tau_nm"])[self.actuated]
        encoder = plant["encoder"]
        self.grid = settings.by_kind(encoder, "resolution_rad", "resolution_m")
        self.data = mujoco.MjData(model)
        self.data.qpos[:] = np.where(actuated, settings.positions(plant["start"], "q"), 0)
        if plant["start"]["unactuated"] == "rest":
            self._rest()
        if self.coulomb.any() or self.stiffness.any():
            mujoco.set_mjcb_passive(self._add_passive)
        self.tau = np.zeros(len(self.actuated))
        self.braking, self.fault, self.saturated = True, False, False
        self.seq = 1

    @property
    def sizes(self):
        """Numbers of joints and of actuated joints."""
        return len(self.grid), len(self.tau)

    def _rest(self):
        """Newton's method for the minimum of the potential over the unactuated joints."""
        data, free = self.data, self.unactuated
        step = 1e-6

        def gravity():
            mujoco.mj_forward(self.model, data)
            return data.qfrc_bias[free].copy()

        for _ in range(100):
            g = gravity()
            curvature = np.empty((len(free), len(free)))
            for column, i in enumerate(free):
                data.qpos[i] += step
                curvature[:, column] = (gravity() - g) / step
                data.qpos[i] -= step
            # Downhill also where the curvature is negative, and not far at once.
            values, vectors = np.linalg.eigh((curvature + curvature.T) / 2)
            change = vectors @ (vectors.T @ g / np.maximum(np.abs(values), 1e-9))
            data.qpos[free] -= change * min(1, 0.5 / max(np.linalg.norm(change), 1e-300))
        if np.abs(gravity()).max() > 1e-9 or values.min() <= 0:
            raise ValueError("start of plant.toml: the unactuated joints have no rest there")

    def _add_passive(self, _, data):
        """Coulomb friction and stops, in every stage of an integration step."""
        q, qd = data.qpos, data.qvel
        data.qfrc_passive -= self.coulomb * np.tanh(qd / self.smoothing)
        below, above = self.stop_range[0] - q, q - self.stop_range[1]
        direction, depth = np.where(above > below, 1, -1), np.maximum(above, below)
        back = np.maximum(self.stiffness * depth + self.damping * qd * direction, 0)
        data.qfrc_passive -= np.where((self.stiffness > 0) & (depth > 0), direction * back, 0)

    def _brake_torque(self):
        """Of u = -qd_A / time constant: the rows A of (1), with qdd_U from the rows U."""
        model, data = self.model, self.data
        mujoco.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        h = data.qfrc_bias - data.qfrc_passive
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

    def answer(self, seq, going):
        """The command that answers measurement `seq`; None if the daemon is lost, or not `going` any more."""
        begin, patience = time.monotonic(), LOST_AFTER_S[0]
        while going():
            command = self.take(seq)
            if command is not None and command.measurement_seq == seq:
                return command
            waited = time.monotonic() - begin
            if waited > patience:
                if patience == LOST_AFTER_S[1] or not self.node.lives(self.reader):
                    return None
                patience = LOST_AFTER_S[1]
            elif waited > SPIN_S:
                time.sleep(NAP_S)
        return None


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
            command = daemon.answer(plant.seq, going)
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
    add_system_options(parser)
    parser.add_argument("--domain", default="upswing")
    args = parser.parse_args()
    stop = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.append(True))
    settings = Settings(args.system, args.program)
    plant = Plant(settings)
    pose = ", ".join(joint.text(q) for joint, q in zip(settings.joints, plant.data.qpos))
    print(f"MuJoCo {mujoco.__version__}: {pose}", file=sys.stderr)
    run(plant, Node(args.domain, "mujoco plant"), lambda: not stop)


if __name__ == "__main__":
    main()
