"""Solves the same swing-up problems with upswing and with CasADi + IPOPT, on one core, and compares.

Started by bench/offline/run, which sets up everything this needs.
"""

import argparse
import datetime
import itertools
import json
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

import peer as ipopt
from peer import Peer, cpu_seconds

ROOT = Path(__file__).resolve().parents[2]
MODEL_TOLERANCE = 1e-9
"""Largest difference between the two models, relative to the largest entry (or absolute below 1)."""


def arguments():
    parser = argparse.ArgumentParser(prog="bench/offline/run", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--torque", choices=("exact", "paper"), default="exact", help="torque constraint: (9) or (11) [%(default)s]"
    )
    parser.add_argument("--points", type=int, default=16, help="how many starts of the grid [%(default)s]")
    parser.add_argument("--core", type=int, help="core that both run on [the last one]")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers to FILE")
    parser.add_argument("--upswing", type=Path, required=True, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.points < 1:
        parser.error("--points: expected 1 or more")
    return options


def settings_folder(upswing: Path, torque: str, folder: Path) -> Path:
    """The settings in full with the torque constraint asked for; both sides read them."""
    subprocess.run([upswing, "config", "export", folder], check=True, stdout=subprocess.DEVNULL)
    planner = folder / "planner.toml"
    # The first one, of the section [offline]; a replan has its own.
    text, count = re.subn(r'(?m)^torque = ".*"$', f'torque = "{torque}"', planner.read_text(), count=1)
    if count != 1:
        sys.exit("error: planner.toml: expected a line `torque = ...`, got none")
    planner.write_text(text)
    return folder


def check_model(upswing: Path, folder: Path, model: ca.Function):
    """Stops unless `upswing model eval` agrees with the peer's model at random states."""
    random = np.random.default_rng(1)
    states = [
        {name: random.uniform(-most, most, model.size1_in(name)) for name, most in (("q", 2), ("qd", 1.5), ("u", 10))}
        for _ in range(8)
    ]
    lines = "\n".join(json.dumps({k: list(v) for k, v in state.items()}) for state in states)
    answer = subprocess.run(
        [upswing, "model", "eval", "--system", folder], input=lines, capture_output=True, text=True
    )
    if answer.returncode:
        sys.exit(f"error: `upswing model eval` failed: {answer.stderr.strip()}")
    worst = 0.0
    for i, (state, line) in enumerate(zip(states, answer.stdout.splitlines(), strict=True)):
        ours, theirs = json.loads(line), model(**state)
        for name in model.name_out():
            expected = np.squeeze(np.array(theirs[name]))
            difference = np.abs(np.array(ours[name]) - expected).max() / max(1.0, np.abs(expected).max())
            if not difference <= MODEL_TOLERANCE:
                sys.exit(
                    f"error: the models disagree: `{name}` at random state {i}: relative difference {difference:.1e}, "
                    f"expected at most {MODEL_TOLERANCE:.0e}; a comparison would be meaningless"
                )
            worst = max(worst, difference)
    print(f"models agree at {len(states)} random states: largest relative difference {worst:.1e}")


def grid_starts(peer: Peer, points: int) -> list[list[float]]:
    """Arm poses (deg), a fixed random choice of those of the grid whose pendulum rests within its limits."""
    axes = peer.settings.grid
    values = [np.linspace(a["from_deg"], a["to_deg"], a["points"]) for a in axes]
    poses = []
    for product in itertools.product(*values):
        pose = np.zeros(peer.chain.n_a)
        pose[[a["joint"] for a in axes]] = product
        unactuated = slice(peer.chain.n_a, peer.chain.n)
        if np.all(np.abs(peer.rest(np.radians(pose))[unactuated]) <= peer.settings.q_max[unactuated]):
            poses.append(pose.tolist())
    if points > len(poses):
        sys.exit(f"error: --points: expected at most the grid's {len(poses)} starts, got {points}")
    # Equal steps through the list would meet the same angles of the last joints again and again.
    chosen = np.random.default_rng(0).choice(len(poses), points, replace=False)
    return [poses[i] for i in sorted(chosen)]


def solve_with_upswing(upswing: Path, folder: Path, pose: list[float]) -> dict:
    command = [upswing, "optimize", "--json", "--system", folder, "--start", ",".join(f"{v:.12g}" for v in pose)]
    before = cpu_seconds(resource.RUSAGE_CHILDREN)
    answer = subprocess.run(command, capture_output=True, text=True)
    cpu = cpu_seconds(resource.RUSAGE_CHILDREN) - before
    try:
        return json.loads(answer.stdout) | {"cpu_s": cpu}
    except json.JSONDecodeError:
        sys.exit(f"error: `upswing optimize` gave no result for {pose}: {answer.stderr.strip()}")


def compare(upswing: Path, folder: Path, peer: Peer, pose: list[float]) -> dict:
    ours = solve_with_upswing(upswing, folder, pose)
    start = peer.rest(np.radians(pose))
    theirs = peer.solve(start)
    x, u = np.array(ours.pop("x")), np.array(ours.pop("u"))
    both = ours["status"] == "solved" and theirs.solved
    return {
        "start_deg": pose,
        "upswing": ours,
        "ipopt": vars(theirs),
        "audit": peer.audit(start, ours["t_f"], x, u),
        "cost_difference_percent": 100 * (ours["cost"] / theirs.cost - 1) if both else None,
        "ratio": theirs.cpu_s / ours["cpu_s"] if both else None,
    }


HEADER = (
    f"{'start: q_A, deg':>31} | {'cost':^25} | {'iterations':^10} | {'time, s':^24} | {'ratio':>6}\n"
    f"{'':>31} | {'ours':>8} {'IPOPT':>8} {'diff %':>7} | {'ours':>4} {'IPOPT':>5} |"
    f" {'ours':>7} {'CPU':>7} {'IPOPT':>8} |"
)


def table_line(row: dict) -> str:
    ours, theirs = row["upswing"], row["ipopt"]
    our_cost = f"{ours['cost']:.5f}" if ours["status"] == "solved" else "failed"
    their_cost = f"{theirs['cost']:.5f}" if theirs["solved"] else "failed"
    difference, ratio = row["cost_difference_percent"], row["ratio"]
    return (
        f"{','.join(f'{v:.0f}' for v in row['start_deg']):>31} |"
        f" {our_cost:>8} {their_cost:>8} {'-' if difference is None else f'{difference:+.3f}':>7} |"
        f" {ours['iterations']:4d} {theirs['iterations']:5d} | {ours['time_s']:7.3f} {ours['cpu_s']:7.3f} {theirs['cpu_s']:8.2f} | {'-' if ratio is None else f'{ratio:.1f}':>6}"
    )


def summarise(rows: list[dict]) -> dict:
    both = [row for row in rows if row["ratio"] is not None]

    def median(values):
        return statistics.median(values) if both else None

    differences = [row["cost_difference_percent"] for row in both]
    return {
        "starts": len(rows),
        "solved_by_upswing": sum(row["upswing"]["status"] == "solved" for row in rows),
        "solved_by_ipopt": sum(row["ipopt"]["solved"] for row in rows),
        "solved_by_both": len(both),
        "median_ratio": median(row["ratio"] for row in both),
        "smallest_ratio": min((row["ratio"] for row in both), default=None),
        "largest_ratio": max((row["ratio"] for row in both), default=None),
        "median_cost_difference_percent": median(differences),
        "largest_cost_difference_percent": max(differences, default=None),
        "cost_0_1_percent_higher": sum(d > 0.1 for d in differences),
        "cost_2_percent_higher": sum(d > 2 for d in differences),
        "cost_0_1_percent_lower": sum(d < -0.1 for d in differences),
        "median_iterations": [median(row[who]["iterations"] for row in both) for who in ("upswing", "ipopt")],
        "median_time_s": median(row["upswing"]["time_s"] for row in both),
        "median_cpu_s": [median(row[who]["cpu_s"] for row in both) for who in ("upswing", "ipopt")],
        "audit": {
            key: max((row["audit"][key] for row in rows if row["upswing"]["status"] == "solved"), default=None)
            for key in rows[0]["audit"]
            if key != "cost"
        },
    }


def print_summary(s: dict):
    print(f"\nsolved: {s['solved_by_upswing']} of {s['starts']} by upswing, {s['solved_by_ipopt']} by IPOPT")
    if not s["solved_by_both"]:
        return
    print(
        f"over the {s['solved_by_both']} that both solved:\n"
        f"  CPU time IPOPT / upswing: median {s['median_ratio']:.1f}, "
        f"smallest {s['smallest_ratio']:.1f}, largest {s['largest_ratio']:.1f}\n"
        f"  median CPU time: upswing {s['median_cpu_s'][0]:.3f} s, IPOPT {s['median_cpu_s'][1]:.2f} s\n"
        f"  median iterations: upswing {s['median_iterations'][0]:g}, IPOPT {s['median_iterations'][1]:g}\n"
        f"  cost of upswing against IPOPT: median {s['median_cost_difference_percent']:+.4f} %, "
        f"largest {s['largest_cost_difference_percent']:+.3f} %; more than 0.1 % higher {s['cost_0_1_percent_higher']}, "
        f"more than 2 % higher {s['cost_2_percent_higher']}, more than 0.1 % lower {s['cost_0_1_percent_lower']} times"
    )
    a = s["audit"]
    print(
        "upswing's solutions in the peer's model, largest of all: "
        f"defect {a['defect']:.1e} (rad, rad/s), start {a['start']:.1e}, target {a['target']:.1e},\n"
        f"  beyond a limit: position {a['position_rad']:.1e} rad, velocity {a['velocity_rad_s']:.1e} rad/s, "
        f"torque {a['torque_nm']:.1e} N m, t_F {a['t_f_s']:.1e} s"
    )


def output_of(*command) -> str:
    try:
        answer = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    except OSError:
        return "unknown"
    return answer.stdout.strip().partition("\n")[0] or "unknown"


def machine() -> dict:
    models = re.findall(r"(?m)^model name\s*:\s*(.*)$", Path("/proc/cpuinfo").read_text())
    return {
        "cpu": models[0] if models else "unknown",
        "architecture": platform.machine(),
        "cores": os.cpu_count(),
        "load_average_at_start": os.getloadavg(),
    }


def versions(upswing: Path) -> dict:
    return {
        "upswing": output_of(upswing, "--version"),
        "commit": output_of("git", "describe", "--always", "--dirty"),
        "rustc": output_of("rustc", "--version"),
        "casadi": ca.__version__,
        "ipopt": ipopt.ipopt_version(),
        "numpy": np.__version__,
        "python": platform.python_version(),
        "gcc": output_of("gcc", "--version"),
        "gcc_flags": ipopt.C_FLAGS,
    }


def main():
    options = arguments()
    upswing = options.upswing.resolve()
    cores = os.sched_getaffinity(0)
    core = max(cores) if options.core is None else options.core
    if core not in cores:
        sys.exit(f"error: --core: expected one of {sorted(cores)}, got {core}")
    # Inherited by the processes started from here.
    os.sched_setaffinity(0, {core})
    report = {
        "date": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "machine": machine(),
        "versions": versions(upswing),
        "torque": options.torque,
        "core": core,
    }
    with tempfile.TemporaryDirectory() as temporary:
        folder = settings_folder(options.upswing, options.torque, Path(temporary))
        peer = Peer(folder, options.torque, ROOT / "bench" / ".cache")
        check_model(upswing, folder, peer.model)
        print(f"CasADi {ca.__version__}, {report['versions']['ipopt']}")
        print(f"core {core}, torque constraint: {options.torque}")
        print("time: ours = inside the solver, CPU = our whole process, IPOPT = its CPU time; ratio = IPOPT / CPU\n")
        print(HEADER, flush=True)
        rows = []
        for pose in grid_starts(peer, options.points):
            rows.append(compare(upswing, folder, peer, pose))
            print(table_line(rows[-1]), flush=True)
    report |= {"summary": summarise(rows), "problems": rows}
    print_summary(report["summary"])
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
