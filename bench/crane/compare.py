"""Rest to rest over 5 m of bridge: duration and residual swing of the optimal plan and of a shaped trapezoidal velocity profile.

The optimal plan is flown by daemon, planner and simulated plant; its swing is measured from the end of the plan on. The peer is a trapezoidal
velocity profile of the bridge, convolved with a ZV shaper (two impulses, half a period of the load apart; Singer, Seering, J. Dyn. Sys. Meas.
Control 112, 1990), tracked without error, with the load as a point mass. Both have the same speed and the same force: of the shaped profile the
swing settles at atan(a / g), where the bridge needs a (M + m), M bridge and trolley, m everything that hangs.
"""

import csv
import json
import math
import re
import subprocess
import sys
import tempfile
from pathlib import Path

UPSWING = Path(sys.argv[1]).resolve()
START, END = -2.5, 2.5
# m: the hoist's position at the end of every move; distance from it to the centre of mass of the load.
HOIST, HOOK = 1.4, 0.1
GRAVITY = 9.81
# What plans may use of robot.toml: m/s, N, m/s.
SPEED, FORCE, HOIST_SPEED = 0.9 * 1.2, 0.8 * 130, 0.9 * 0.8
# kg: bridge, trolley, fork, guide, load.
MASS = 60 + 15 + 0.2 + 0.3 + 10
# s, integration of the peer.
DT = 1e-4


def export(folder, hoist_range):
    """Writes the settings of the crane, the range (m) of its hoist replaced if there is one."""
    subprocess.run([UPSWING, "config", "export", folder, "--system", "gantry-crane"], check=True, capture_output=True)
    if hoist_range is None:
        return
    low, high = hoist_range

    def replace(name, pattern, by):
        text, count = re.subn(pattern, by, (folder / name).read_text())
        assert count, f"{name}: {pattern}"
        (folder / name).write_text(text)

    replace("robot.toml", r"hoist = \[0.4, 1.6\]", f"hoist = [{low}, {high}]")
    replace("robot.urdf", r'lower="0.4" upper="1.6"', f'lower="{low}" upper="{high}"')
    replace("manoeuvres.toml", r'("hoist".*) from_m = .*, points = \d+', rf"\1 value_m = {HOIST}")
    for database in folder.glob("*.bin"):
        database.unlink()


def optimal(hoist, hoist_range=None):
    """Duration (s) and residual swing (deg) of the optimal plan that begins with the hoist at `hoist` (m)."""
    with tempfile.TemporaryDirectory() as parent:
        folder = Path(parent) / "crane"
        export(folder, hoist_range)
        recording, table = folder / "run.mcap", folder / "run.csv"
        demo = [UPSWING, "demo", "--system", folder, "--clock", "lockstep", f"--start={START},0.8,{hoist}", "--json"]
        files = ["--record", recording, "--picture", folder / "run.svg"]
        # Not checked: a rope of constant length is a narrow range, which the hoist leaves by a fraction of a millimetre.
        run = subprocess.run([*demo, *files], stdout=subprocess.PIPE, text=True)
        subprocess.run([UPSWING, "export", recording, "--csv", table], check=True, capture_output=True)
        swing = 0.0
        with table.open() as rows:
            for row in csv.DictReader(rows):
                # In Track the swing counts from 0 again: what is left is that of the Hold after the last plan.
                tracks = row["mode"] == "2"
                sway = math.hypot(float(row["q_sway_x_rad"]), float(row["q_sway_y_rad"]))
                swing = 0.0 if tracks else max(swing, sway)
        return json.loads(run.stdout)["t_f"], math.degrees(swing)


def trapezoid(way, speed, acceleration):
    """Acceleration over time of a trapezoidal velocity profile, and its duration (s)."""
    assert way > speed**2 / acceleration
    ramp, total = speed / acceleration, way / speed + speed / acceleration
    return lambda t: acceleration * ((0 <= t < ramp) - (total - ramp <= t < total)), total


def shaped(hoist):
    """Duration (s) and residual swing (deg) of the shaped profile; the hoist moves with its own profile from the beginning."""
    length = (hoist + HOIST) / 2 + HOOK
    shift = math.pi * math.sqrt(length / GRAVITY)
    bridge, total = trapezoid(END - START, SPEED, FORCE / MASS)
    # The hoist is faster than the bridge: its acceleration hardly matters.
    way = HOIST - hoist
    lift, _ = trapezoid(abs(way), HOIST_SPEED, 2.0) if way else (lambda t: 0.0, 0.0)
    angle, rate, rope, rope_rate, swing, t = 0.0, 0.0, hoist + HOOK, 0.0, 0.0, 0.0
    while t < total + shift + 10:
        acceleration = (bridge(t) + bridge(t - shift)) / 2
        # Semi-implicit Euler.
        rope_rate += DT * math.copysign(1, way) * lift(t)
        rope += DT * rope_rate
        rate += DT * (-GRAVITY * math.sin(angle) - acceleration * math.cos(angle) - 2 * rope_rate * rate) / rope
        angle += DT * rate
        t += DT
        if t > total + shift:
            swing = max(swing, abs(angle))
    return total + shift, math.degrees(swing)


def main():
    print("| move of 5 m | optimal plan, s | swing after it, deg | trapezoid + ZV, s | swing after it, deg | shorter |")
    print("|---|---|---|---|---|---|")
    moves = [
        ("rope of constant length", HOIST, (HOIST - 2e-3, HOIST + 2e-3)),
        ("same length at both ends, free in between", HOIST, None),
        ("lowered by 0.8 m on the way", HOIST - 0.8, None),
    ]
    for name, hoist, hoist_range in moves:
        (plan, left), (peer, peer_left) = optimal(hoist, hoist_range), shaped(hoist)
        print(f"| {name} | {plan:.2f} | {left:.3f} | {peer:.2f} | {peer_left:.3f} | {100 * (1 - plan / peer):.0f} % |")


main()
