"""Tests of the examples; `test` runs them. Argument: the program upswing."""

import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
import unittest
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import upswing_layouts as layouts
from manoeuvre import of_joints
from mujoco_plant import load
from upswing_ipc import Node
from upswing_layouts import Mode
from upswing_settings import Settings

HERE = Path(__file__).parent
UPSWING = sys.argv.pop()
SYSTEMS = sorted(folder.name for folder in (HERE.parents[1] / "config" / "systems").iterdir())
# Without a database a plan may take longer than a flight.
FLYING = [name for name in SYSTEMS if any((HERE.parents[1] / "config" / "systems" / name).glob("*.bin"))]
# Encoder steps fall at other moments as soon as two plants differ in the last bits, and the feedback answers each step: the
# differences are those that steps of up to 3e-3 rad leave in a controlled motion.
COURSE, END = 5e-3, 1e-3
# The planner adapts one of several entries that are nearly equally good: where the starts differ by encoder steps, it may choose another
# one, and the plans end in other poses of the same target. Such a pair is flown again.
PAIRS = 4
# Far beyond anything that is waited for.
LONG_S = 300


class Layouts(unittest.TestCase):
    def test_sizes_and_offsets_are_those_of_rust(self):
        structures = [c for c in vars(layouts).values() if isinstance(c, type) and hasattr(c, "OFFSETS")]
        self.assertGreaterEqual(len(structures), 13)
        for structure in structures:
            self.assertEqual(ctypes.sizeof(structure), structure.SIZE, structure.__name__)
            offsets = {name: getattr(structure, name).offset for name, _ in structure._fields_}
            self.assertEqual(offsets, structure.OFFSETS, structure.__name__)


class System:
    """Processes of a domain; ended, and the domain removed, at the end of the block."""

    def __init__(self, name):
        self.domain = f"python-{os.getpid()}-{name}"
        self.processes = []

    def __enter__(self):
        self.folder = tempfile.TemporaryDirectory()
        return self

    def start(self, *command):
        log = open(Path(self.folder.name) / f"{len(self.processes)}.log", "w+", encoding="utf-8")
        command = [*map(str, command), "--domain", self.domain]
        self.processes.append((subprocess.Popen(command, stdout=log, stderr=log), log))

    def logs(self):
        for _, log in self.processes:
            log.seek(0)
            yield log.read()

    def __exit__(self, *_):
        for process, log in reversed(self.processes):
            process.terminate()
            process.wait(LONG_S)
            log.close()
        self.folder.cleanup()
        subprocess.run(["rm", "-rf", f"/dev/shm/upswing.{self.domain}.iox"], check=True)
        for file in Path("/dev/shm").glob(f"upswing_{self.domain}_*"):
            file.unlink()


class Dynamics(unittest.TestCase):
    def test_mujoco_has_mass_matrix_and_forces_of_the_model(self):
        """At random states in the ranges of the joints; in both, M and C qd + g are sums of the same terms: only rounding differs."""
        for system in SYSTEMS:
            with self.subTest(system):
                settings = Settings(system, UPSWING)
                model = load(settings.urdf)
                data, n, random = mujoco.MjData(model), model.nv, np.random.default_rng(1)
                lowest, highest = settings.positions(settings.robot["limits"], "q").T
                states = [(random.uniform(lowest, highest), random.uniform(-10, 10, n)) for _ in range(100)]
                u = [0] * sum(joint.actuated for joint in settings.joints)
                lines = "\n".join(json.dumps({"q": q.tolist(), "qd": qd.tolist(), "u": u}) for q, qd in states)
                command = [UPSWING, "model", "eval", "--system", system]
                run = subprocess.run(command, input=lines, capture_output=True, text=True, check=True)
                mass = np.empty((n, n))
                for (q, qd), line in zip(states, run.stdout.splitlines(), strict=True):
                    expected = json.loads(line)
                    data.qpos[:], data.qvel[:] = q, qd
                    mujoco.mj_forward(model, data)
                    mujoco.mj_fullM(model, data, mass)
                    # Relative to sqrt(M_ii M_jj), so that units do not matter, and to the largest force.
                    scale = np.sqrt(mass.diagonal())
                    self.assertLess(np.abs((mass - expected["M"]) / np.outer(scale, scale)).max(), 1e-9)
                    forces = np.array(expected["nle"])
                    self.assertLess(np.abs(data.qfrc_bias - forces).max(), 1e-9 * np.abs(forces).max())


class Flights(unittest.TestCase):
    def fly(self, system, name, plant, *options):
        """The first manoeuvre of a system, as the client executes it; what it prints, and its records."""
        for process in ("planner", "daemon"):
            system.start(UPSWING, process, "--system", name)
        system.start(*plant, "--system", name)
        saved = Path(system.folder.name) / "records.npy"
        client = [sys.executable, HERE / "manoeuvre.py", "--system", name, "--program", UPSWING, "--domain", system.domain]
        # Until the daemon has found planner and plant, it refuses.
        end = time.monotonic() + 60
        while True:
            command = [*client, "--seconds", "2", "--save", saved, *options]
            run = subprocess.run(command, capture_output=True, text=True, timeout=LONG_S)
            if run.returncode == 0 or time.monotonic() > end or "no measurement received" not in run.stderr:
                break
            time.sleep(0.5)
        self.assertEqual(run.returncode, 0, "\n".join([name, run.stderr, *system.logs()]))
        return run.stdout, np.load(saved)

    def test_the_client_sees_every_cycle_and_the_plan(self):
        with System("client") as system:
            picture = Path(system.folder.name) / "swing-up.svg"
            printed, records = self.fly(system, "iiwa-pendulum", [UPSWING, "plant"], "--plot", picture)
            print(printed)
            self.assertIn("<svg", picture.read_text(encoding="utf-8"))
            self.assertIn(f"{len(records)} received, 0 lost", printed)
            self.assertTrue((np.diff(records["seq"]) == 1).all())
            self.check_plan(system)

    def check_plan(self, system):
        """The newest plan: its shapes, and its defects (6b)."""
        plans, end = Node(system.domain, "python test").subscribe_plans(), time.monotonic() + 60
        while (plan := plans.take()) is None and time.monotonic() < end:
            time.sleep(0.01)
        knots = plan.header.intervals + 1
        shapes = [array.shape for array in (plan.x, plan.u, plan.f, plan.k, plan.k_final)]
        self.assertEqual(shapes, [(knots, 18), (knots, 7), (knots, 18), (knots, 7, 18), (7, 18)])
        half_h = 0.5 * plan.header.t_f / plan.header.intervals
        defects = plan.x[1:] - plan.x[:-1] - half_h * (plan.f[1:] + plan.f[:-1])
        self.assertLess(np.abs(defects).max(), 1e-3)

    def test_with_mujoco_each_system_ends_as_with_the_own_plant(self):
        """The same request; means of the last half second, and the largest difference from the start of the plan on."""
        plants = {"own": [UPSWING, "plant"], "mujoco": [sys.executable, HERE / "mujoco_plant.py", "--program", UPSWING]}

        def fly(name, plant):
            with System(f"{name[:10]}-{plant}") as system:
                printed, records = self.fly(system, name, plants[plant])
            track = np.flatnonzero(records["mode"] == Mode.Track)
            planned = of_joints(records[track[-1:]], "q_d")
            return of_joints(records[track[0] :], "q"), planned, records["mode"][-1], printed

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            flights = {name: [pool.submit(fly, name, plant) for plant in plants] for name in FLYING}
            for name, both in flights.items():
                with self.subTest(name):
                    for _ in range(PAIRS):
                        (own, own_end, own_mode, own_text), (other, other_end, other_mode, other_text) = (flight.result() for flight in both)
                        self.assertEqual(other_mode, own_mode)
                        if np.abs(own_end - other_end).max() < COURSE:
                            break
                        both = [pool.submit(fly, name, plant) for plant in plants]
                    common = min(len(own), len(other))
                    difference = own[:common] - other[:common]
                    course, end = np.abs(difference).max(), np.abs(difference[-4000:].mean(axis=0)).max()
                    print(f"{name:<16} MuJoCo and the own plant: within {course:.1e} at any time, {end:.1e} at the end, rad or m")
                    self.assertLess(course, COURSE, f"\n{own_text}\n{other_text}")
                    self.assertLess(end, END)


if __name__ == "__main__":
    unittest.main()
