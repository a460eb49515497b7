"""Tests of the examples; `test` runs them. Argument: the program upswing."""

import ctypes
import os
import re
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

import numpy as np
import upswing_layouts as layouts
from upswing_ipc import Node

HERE = Path(__file__).parent
UPSWING = sys.argv.pop()
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


class SwingUps(unittest.TestCase):
    def swing_up(self, system):
        """Runs the client; the tracking error, rad, and the tilt in balance, deg, that it prints."""
        system.start(UPSWING, "planner")
        system.start(UPSWING, "daemon")
        picture = Path(system.folder.name) / "swing-up.svg"
        client = [sys.executable, HERE / "swing_up.py", "--domain", system.domain, "--seconds", "2"]
        # Until the daemon has found planner and plant, it refuses.
        end = time.monotonic() + 60
        while True:
            run = subprocess.run([*client, "--plot", picture], capture_output=True, text=True, timeout=LONG_S)
            if run.returncode == 0 or time.monotonic() > end or "no measurement received" not in run.stderr:
                break
            time.sleep(0.5)
        self.assertEqual(run.returncode, 0, "\n".join([run.stderr, *system.logs()]))
        self.assertIn("<svg", picture.read_text(encoding="utf-8"))
        print(run.stdout)
        tracking = float(re.search(r"within ([\d.]+) rad", run.stdout)[1])
        tilt = float(re.search(r"within ([\d.]+) deg", run.stdout)[1])
        return tracking, tilt

    def test_the_client_swings_up_and_sees_every_cycle(self):
        with System("client") as system:
            system.start(UPSWING, "plant")
            tracking, tilt = self.swing_up(system)
            self.assertLess(tracking, 0.1)
            self.assertLess(tilt, 2)
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

    def test_mujoco_takes_the_place_of_the_plant(self):
        with System("mujoco") as system:
            settings = Path(system.folder.name) / "settings"
            subprocess.run([UPSWING, "config", "export", settings], check=True, capture_output=True)
            system.start(sys.executable, HERE / "mujoco_plant.py", "--system", settings)
            tracking, tilt = self.swing_up(system)
            self.assertLess(tracking, 0.1)
            self.assertLess(tilt, 2)


if __name__ == "__main__":
    unittest.main()
