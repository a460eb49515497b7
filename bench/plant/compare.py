"""Moves the plant simulator and two independent simulators from the same states under the same torques, and compares.

Started by bench/plant/run, which sets up everything this needs. All read the same URDF; friction is off.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from scipy.integrate import DOP853

ROOT = Path(__file__).resolve().parents[2]
PERIOD = 125e-6
"""Control period, s: torques are constant over it."""
SUBSTEPS = 4
"""MuJoCo's steps per period: twice as many as the plant's here."""
TOLERANCE = 1e-12
"""Relative and absolute tolerance of DOP853."""
SCENARIO = """purpose = "The plant without friction, as the other simulators have it."
[model]
urdf = "{urdf}"
[friction]
viscous = 0
coulomb = 0
compensation = 1.0
[integrator]
substeps = 2
"""
ALLOWED = 1e-7
"""Largest difference that passes over half a second, rad and rad/s. It leaves room for the plant's integration steps in a
free fall at twenty times the velocity limits."""


@dataclass
class Case:
    name: str
    q_deg: list[float]
    qd: list[float] | None
    """None: at rest."""
    wave: float | None
    """How far the actuated joints move to and fro, rad; None: without torque."""


CASES = [
    Case("held arm, swinging rod", [0, -15, 0, -95, 0, 10, 0, 120, 20], None, 0.0),
    Case("waves on all joints", [10, 10, 20, -100, 30, -20, 0, 5, -5], None, 0.4),
    Case("moving start, waves", [-40, 30, -60, -60, 50, 40, 90, 100, 10], [0.3, -0.2, 0.4, 0.1, -0.5, 0.6, 0.2, 1.5, -1], 0.2),
    Case("free fall", [0, -15, 0, -95, 0, 10, 0, 0, 0], None, None),
]


class Pinocchio:
    """Forward dynamics of Pinocchio, integrated period by period with DOP853."""

    name = f"Pinocchio {pin.__version__}, DOP853"

    def __init__(self, urdf: Path):
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.data = self.model.createData()
        actuated = self.model.effortLimit > 0
        self.n, self.n_a = self.model.nv, int(actuated.sum())
        """Numbers of joints and of actuated joints."""
        if not actuated[: self.n_a].all():
            sys.exit(f"error: {urdf.name}: expected actuated joints, then unactuated ones")

    def move(self, x, torques):
        """States at the end of the periods; `torques`: of each period, or a function of time and state."""
        n, states = self.n, []
        for k, tau in enumerate(torques):
            full = np.concatenate([tau(k * PERIOD, x) if callable(tau) else tau, np.zeros(n - self.n_a)])

            def f(_, x):
                return np.concatenate([x[n:], pin.aba(self.model, self.data, x[:n], x[n:], full)])

            solver = DOP853(f, 0.0, x, PERIOD, rtol=TOLERANCE, atol=TOLERANCE, first_step=PERIOD)
            while solver.status == "running":
                solver.step()
            if solver.status != "finished":
                sys.exit("error: DOP853 failed")
            x = solver.y
            states.append(x)
        return np.array(states)

    def torque_for(self, u, x):
        """Torques of the actuated joints that accelerate them with u: (3a), (3b)."""
        n_a, q, qd = self.n_a, x[: self.n], x[self.n :]
        nle = pin.nonLinearEffects(self.model, self.data, q, qd)
        mass = pin.crba(self.model, self.data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        free = -np.linalg.solve(mass[n_a:, n_a:], mass[n_a:, :n_a] @ u + nle[n_a:])
        return mass[:n_a] @ np.concatenate([u, free]) + nle[:n_a]


class MuJoCo:
    """MuJoCo with its Runge-Kutta integrator, four steps per period."""

    name = f"MuJoCo {mujoco.__version__}, RK4"

    def __init__(self, urdf: Path):
        # Its compiler refuses inertias that miss the triangle inequality, as identified ones may by rounding: it is told
        # to balance them, and then given the true ones.
        spec = mujoco.MjSpec.from_file(str(urdf))
        spec.compiler.balanceinertia = True
        spec.compiler.boundmass = 0
        spec.compiler.boundinertia = 0
        self.model = spec.compile()
        self.restore_inertias(urdf)
        option = self.model.opt
        option.timestep = PERIOD / SUBSTEPS
        option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        option.gravity = (0, 0, -9.81)
        option.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT | mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.data = mujoco.MjData(self.model)

    def restore_inertias(self, urdf: Path):
        """Masses, centres of mass and inertias of the moving bodies as Pinocchio reads them from the same file."""
        reference = pin.buildModelFromUrdf(str(urdf))
        for joint in range(self.model.nv):
            body = self.model.jnt_bodyid[joint]
            expected = reference.inertias[joint + 1]
            if not np.isclose(self.model.body_mass[body], expected.mass, rtol=1e-12):
                sys.exit(f"error: joint {joint + 1}: MuJoCo read {self.model.body_mass[body]} kg, expected {expected.mass}")
            if not np.allclose(self.model.body_ipos[body], expected.lever, atol=1e-12):
                sys.exit(f"error: joint {joint + 1}: MuJoCo read another centre of mass")
            moments, axes = np.linalg.eigh(expected.inertia)
            if np.linalg.det(axes) < 0:
                axes[:, 0] = -axes[:, 0]
            self.model.body_inertia[body] = moments
            mujoco.mju_mat2Quat(self.model.body_iquat[body], axes.flatten())
        mujoco.mj_setConst(self.model, mujoco.MjData(self.model))

    def move(self, x, torques):
        data, n, states = self.data, self.model.nv, []
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = x[:n], x[n:]
        for tau in torques:
            data.qfrc_applied[: tau.size] = tau
            for _ in range(SUBSTEPS):
                mujoco.mj_step(self.model, data)
            states.append(np.concatenate([data.qpos, data.qvel]))
        return np.array(states)


class Upswing:
    """The plant simulator."""

    def __init__(self, motion: Path, scenario: Path):
        self.command = [motion, scenario]

    def move(self, x, torques):
        lines = "\n".join(json.dumps(list(line)) for line in [x, *torques])
        answer = subprocess.run(self.command, input=lines, capture_output=True, text=True)
        if answer.returncode:
            sys.exit(f"error: the plant simulator failed: {answer.stderr.strip()}")
        return np.array([json.loads(line) for line in answer.stdout.splitlines()])


def torques_of(case: Case, peer: Pinocchio, x, seconds: float):
    """Torques of each period, N m: recorded once with a controller that follows the waves, so that all simulators can be
    given the same numbers."""
    periods = round(seconds / PERIOD)
    n, n_a = peer.n, peer.n_a
    recorded = np.zeros((periods, n_a))
    if case.wave is None:
        return recorded
    omega = 2 * np.pi * (0.4 + 0.1 * np.arange(n_a))

    def follow(t, state):
        k = round(t / PERIOD)
        q = x[:n_a] + x[n : n + n_a] * np.sin(omega * t) / omega + case.wave * (1 - np.cos(omega * t)) / 2
        qd = x[n : n + n_a] * np.cos(omega * t) + case.wave * omega * np.sin(omega * t) / 2
        recorded[k] = peer.torque_for(100 * (q - state[:n_a]) + 20 * (qd - state[n : n + n_a]), state)
        return recorded[k]

    peer.move(x, [follow] * periods)
    return recorded


def compare(urdf: str, motion: Path, seconds: float, folder: Path) -> list[dict]:
    path = ROOT / "config" / "systems" / "iiwa-pendulum" / urdf
    scenario = folder / f"{path.stem}.toml"
    scenario.write_text(SCENARIO.format(urdf=path))
    plant, peers = Upswing(motion, scenario), [Pinocchio(path), MuJoCo(path)]
    n, rows = peers[0].n, []
    for case in CASES:
        if len(case.q_deg) != n:
            sys.exit(f"error: {urdf}: expected {len(case.q_deg)} joints, got {n}")
        x = np.concatenate([np.radians(case.q_deg), case.qd or [0] * n])
        torques = torques_of(case, peers[0], x, seconds)
        ours = plant.move(x, torques)
        row = {"urdf": urdf, "case": case.name, "fastest_rad_s": float(np.abs(ours[:, n:]).max())}
        for peer in peers:
            theirs = peer.move(x, torques)
            if theirs.shape != ours.shape:
                sys.exit(f"error: expected {theirs.shape[0]} states of the plant simulator, got {ours.shape[0]}")
            difference = np.abs(ours - theirs)
            row[peer.name] = {"rad": float(difference[:, :n].max()), "rad_s": float(difference[:, n:].max())}
        rows.append(row)
        figures = "  ".join(f"{peer.name}: {row[peer.name]['rad']:.1e} rad, {row[peer.name]['rad_s']:.1e} rad/s" for peer in peers)
        print(f"{urdf:16} {case.name:24} up to {row['fastest_rad_s']:5.2f} rad/s  {figures}", flush=True)
    return rows


def main():
    parser = argparse.ArgumentParser(prog="bench/plant/run", description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=0.5, help="length of each motion, s [%(default)s]")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to FILE")
    parser.add_argument("--motion", type=Path, required=True, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if not options.seconds >= PERIOD:
        parser.error(f"--seconds: expected {PERIOD} or more")
    print(f"largest differences over {options.seconds:g} s of motion, {os.cpu_count()} CPUs")
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for urdf in ("robot.urdf", "robot-acin.urdf"):
            rows += compare(urdf, options.motion, options.seconds, Path(folder))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    worst = max(v for row in rows for peer in row.values() if isinstance(peer, dict) for v in peer.values())
    print(f"largest of all: {worst:.1e}; allowed: {ALLOWED:.0e}")
    return 0 if worst <= ALLOWED else 1


if __name__ == "__main__":
    sys.exit(main())
