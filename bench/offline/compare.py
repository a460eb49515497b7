"""Solves the same problems with upswing, with CasADi + IPOPT and with FATROP, on one core, and compares.

Started by bench/offline/run, which sets up everything this needs.
"""

import argparse
import datetime
import hashlib
import json
import os
import platform
import re
import resource
import statistics
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import casadi as ca
import numpy as np

import fatrop
import peer as ipopt
from fatrop import Fatrop
from peer import Peer, Result, Solution, Start, cpu_seconds

ROOT = Path(__file__).resolve().parents[2]
MODEL_TOLERANCE = 1e-9
"""Largest difference between the two models, relative to the largest entry (or absolute below 1)."""
CLOSE, LARGEST, SHARE = 0.1, 2.0, 0.9
"""A system passes if the cost exceeds the lowest known one by at most CLOSE % at this share of the starts, and never by more than
LARGEST %."""
SAME = 1e-5
"""Largest relative difference of the costs of one optimum, solved by upswing and by FATROP: far above both tolerances."""
TURNS = 3
"""How often upswing and FATROP solve each problem, in turns."""


def arguments():
    parser = argparse.ArgumentParser(prog="bench/offline/run", description=__doc__.splitlines()[0])
    parser.add_argument("--system", default="iiwa-pendulum", help="name or folder of the system [%(default)s]")
    parser.add_argument("--manoeuvre", metavar="NAME", help="manoeuvre of its settings [the first one]")
    parser.add_argument(
        "--torque", choices=("exact", "paper"), default="exact", help="torque constraint: (9) or (11) [%(default)s]"
    )
    parser.add_argument("--points", type=int, default=20, help="number of random starts [%(default)s]")
    parser.add_argument("--seed", type=int, default=0, help="of starts and of IPOPT's guesses [%(default)s]")
    parser.add_argument("--grid", type=Path, metavar="FILE", help="random starts of this grid instead")
    parser.add_argument("--guesses", type=int, default=8, help="IPOPT's guesses at each start, at least [%(default)s]")
    parser.add_argument(
        "--most", type=int, default=40, help="and at most, until it finds its best result three times [%(default)s]"
    )
    parser.add_argument(
        "--neighbours", type=int, default=2, help="further guesses: its results at the nearest starts [%(default)s]"
    )
    parser.add_argument(
        "--peers", choices=("both", "ipopt", "fatrop"), default="both", help="what to compare with [%(default)s]"
    )
    parser.add_argument("--core", type=int, help="core that both run on [the last one]")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all numbers and our solutions to FILE")
    parser.add_argument("--keep", type=Path, metavar="FILE", help="keep IPOPT's results in FILE, and take them from there if it exists")
    parser.add_argument("--upswing", type=Path, required=True, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.points < 1 or options.guesses < 1:
        parser.error("--points, --guesses: expected 1 or more")
    options.most = max(options.most, options.guesses)
    return options


def settings_folder(upswing: Path, system: str, torque: str, folder: Path) -> Path:
    """The settings in full with the torque constraint asked for; both sides read them."""
    subprocess.run([upswing, "config", "export", "--system", system, folder], check=True, stdout=subprocess.DEVNULL)
    planner = folder / "planner.toml"
    # The first one, of the section [offline]; a replan has its own.
    text, count = re.subn(r'(?m)^torque = ".*"$', f'torque = "{torque}"', planner.read_text(), count=1)
    if count != 1:
        sys.exit("error: planner.toml: expected a line `torque = ...`, got none")
    planner.write_text(text)
    return folder


def check_model(upswing: Path, folder: Path, peer: Peer):
    """Stops unless `upswing model eval` agrees with the peer's model at random states within the limits."""
    random = np.random.default_rng(1)
    limits = peer.limits
    states = [
        {
            "q": random.uniform(limits.q_min, limits.q_max),
            "qd": random.uniform(-limits.qd_max, limits.qd_max),
            "u": random.uniform(-10, 10, peer.chain.n_a),
        }
        for _ in range(16)
    ]
    lines = "\n".join(json.dumps({k: list(v) for k, v in state.items()}) for state in states)
    answer = subprocess.run(
        [upswing, "model", "eval", "--system", folder], input=lines, capture_output=True, text=True
    )
    if answer.returncode:
        sys.exit(f"error: `upswing model eval` failed: {answer.stderr.strip()}")
    worst = 0.0
    for i, (state, line) in enumerate(zip(states, answer.stdout.splitlines(), strict=True)):
        ours, theirs = json.loads(line), peer.model(**state)
        for name in peer.model.name_out():
            expected = np.array(theirs[name])
            difference = np.abs(np.array(ours[name]) - expected.reshape(np.shape(ours[name]))).max()
            difference /= max(1.0, np.abs(expected).max())
            if not difference <= MODEL_TOLERANCE:
                sys.exit(
                    f"error: the models disagree: `{name}` at random state {i}: relative difference {difference:.1e}, "
                    f"expected at most {MODEL_TOLERANCE:.0e}; a comparison would be meaningless"
                )
            worst = max(worst, difference)
    print(f"models agree at {len(states)} random states: largest relative difference {worst:.1e}")


def shown(peer: Peer, joint: int, value: float) -> float:
    """A position in deg or m."""
    return value if peer.chain.joints[joint].prismatic else float(np.degrees(value))


def command_of(upswing: Path, folder: Path, peer: Peer, pose: str) -> list:
    return [upswing, "optimize", "--json", "--system", folder, "--manoeuvre", peer.manoeuvre.name, f"--start={pose}"]


def seconds_without_solving(upswing: Path, folder: Path, peer: Peer) -> float:
    """CPU time of upswing's process without the solver: it refuses a start far outside of the limits after it has read the settings."""
    command, times = command_of(upswing, folder, peer, ",".join("1e6" for _ in peer.chain.actuated)), []
    for _ in range(9):
        before = cpu_seconds(resource.RUSAGE_CHILDREN)
        if subprocess.run(command, capture_output=True).returncode != 2:
            sys.exit("error: `upswing optimize` accepted a start outside of the limits")
        times.append(cpu_seconds(resource.RUSAGE_CHILDREN) - before)
    return statistics.median(times)


def solve_with_upswing(upswing: Path, folder: Path, peer: Peer, start: Start, best: bool) -> dict:
    chain = peer.chain
    pose = ",".join(f"{shown(peer, i, start.x[i]):.17g}" for i in chain.actuated)
    command = command_of(upswing, folder, peer, pose)
    if best:
        command.append("--best")
    if start.given:
        values = ((joint, shown(peer, chain.names.index(joint), value)) for joint, value in start.given.items())
        command += ["--to", *(f"{joint}={value:.17g}" for joint, value in values)]
    before = cpu_seconds(resource.RUSAGE_CHILDREN)
    answer = subprocess.run(command, capture_output=True, text=True)
    cpu = cpu_seconds(resource.RUSAGE_CHILDREN) - before
    try:
        return json.loads(answer.stdout) | {"cpu_s": cpu}
    except json.JSONDecodeError:
        sys.exit(f"error: `upswing optimize` gave no result for {pose}: {answer.stderr.strip()}")


def swings(peer: Peer, x: np.ndarray) -> list[int]:
    """Of each unactuated joint: how often it swings one way; changes of less than 2 % of its whole motion are none."""
    counts = []
    for i in peer.chain.unactuated:
        least, count, direction, turned = 0.02 * np.ptp(x[:, i]), 1, 0.0, x[0, i]
        for q in x[:, i]:
            if direction * (q - turned) > 0 or (direction == 0 and abs(q - turned) > least):
                direction, turned = np.sign(q - turned), q
            elif abs(q - turned) > least:
                direction, turned, count = -direction, q, count + 1
        counts.append(count)
    return counts


def problem(start: Start) -> dict:
    """The problem as it stands in files."""
    return {"x": start.x.tolist(), "given": start.given, "rows": start.rows.tolist()}


def solve_with_ipopt(peer: Peer, starts: list[Start], options) -> list[Result]:
    """IPOPT's results at all starts, from all guesses."""
    results = []
    for number, start in enumerate(starts):
        result = peer.solve(start, options.guesses, options.most, options.seed + number)
        best = f"{result.best.cost:.5f}" if result.best else "failed"
        print(f"IPOPT, start {number + 1} of {len(starts)}: {result.guesses} guesses, {best}", file=sys.stderr, flush=True)
        results.append(result)
    peer.solve_from_neighbours(starts, results, options.neighbours)
    return results


def kept_results(file: Path, problems: dict) -> list[Result]:
    """IPOPT's results in a file of an earlier run with the same problems."""
    kept = json.loads(file.read_text())
    results = [Result(**result) for result in kept.pop("ipopt")]
    if kept != problems:
        sys.exit(f"error: --keep: {file} has the results of other problems; remove it or name another file")
    for result in results:
        result.best = result.best and Solution(**result.best)
    return results


def compare(upswing: Path, folder: Path, peer: Peer, start: Start, theirs: Result) -> dict:
    first, ours = (solve_with_upswing(upswing, folder, peer, start, best) for best in (False, True))
    x, u = np.array(ours["x"]), np.array(ours["u"])
    costs = [run["cost"] for run in (first, ours) if run["status"] == "solved"]
    lowest = min(costs + theirs.costs, default=None)
    solved = ours["status"] == "solved"
    del first["x"], first["u"]
    return {
        "start": problem(start),
        "start_shown": [shown(peer, i, start.x[i]) for i in peer.chain.actuated],
        "given_shown": [shown(peer, peer.chain.names.index(joint), value) for joint, value in start.given.items()],
        "upswing_first": first,
        "upswing": ours | {"swings": swings(peer, x)},
        "ipopt": asdict(theirs) | {"best": asdict(theirs.best) | {"x": None, "u": None} if theirs.best else None},
        "ipopt_swings": swings(peer, np.array(theirs.best.x)) if theirs.best else None,
        "audit": peer.audit(start, ours["t_f"], x, u),
        "lowest_cost": lowest,
        "excess_percent": 100 * (ours["cost"] / lowest - 1) if solved else None,
        "first_excess_percent": 100 * (first["cost"] / lowest - 1) if first["status"] == "solved" else None,
        "difference_percent": 100 * (ours["cost"] / theirs.best.cost - 1) if solved and theirs.best else None,
        "ratio": theirs.first_cpu_s / first["cpu_s"] if first["status"] == "solved" and theirs.best else None,
    }


def compare_with_fatrop(upswing: Path, folder: Path, peer: Peer, fatrop: Fatrop, start: Start, outside: float) -> dict:
    """upswing and FATROP in turns from the guess that upswing tries first; `outside` is the CPU time of upswing's process without the
    solver."""
    guess, ours, theirs = peer.swing(start), [], []
    for _ in range(TURNS):
        ours.append(solve_with_upswing(upswing, folder, peer, start, False))
        theirs.append(fatrop.attempt(start, guess))
    first, solution = ours[0], theirs[0].solution
    solver_s = statistics.median(run["cpu_s"] for run in ours) - outside
    fatrop_s = statistics.median(run.cpu_s for run in theirs)
    both = solution is not None and first["status"] == "solved"
    return {
        "start": problem(start),
        "upswing": {key: first[key] for key in ("status", "cost", "t_f", "iterations")} | {"cpu_s": solver_s},
        "fatrop": {"iterations": theirs[0].iterations, "cpu_s": fatrop_s, "cost": solution.cost if solution else None},
        "audit": peer.audit(start, solution.t_f, np.array(solution.x), np.array(solution.u)) if solution else None,
        "difference": abs(first["cost"] / solution.cost - 1) if both else None,
        "state_difference": float(np.abs(np.array(first["x"]) - solution.x).max()) if both else None,
        "ratio": fatrop_s / solver_s if both else None,
    }


def fatrop_line(row: dict) -> str:
    ours, theirs = row["upswing"], row["fatrop"]
    result = "failed" if row["ratio"] is None else f"{theirs['cost']:.6f}, ratio {row['ratio']:.1f}"
    return (
        f"upswing {ours['cost']:.6f}, {ours['iterations']} iterations, {1e3 * ours['cpu_s']:.1f} ms | "
        f"FATROP {theirs['iterations']} iterations, {1e3 * theirs['cpu_s']:.0f} ms, {result}"
    )


def summarise_fatrop(rows: list[dict]) -> dict:
    solved = [row for row in rows if row["ratio"] is not None]
    same = [row for row in solved if row["difference"] < SAME]

    def median(value):
        return statistics.median(map(value, same)) if same else None

    def largest(value):
        return max(map(value, same), default=None)

    return {
        "starts": len(rows),
        "solved_by_fatrop": sum(row["fatrop"]["cost"] is not None for row in rows),
        "same_optimum": len(same),
        "median_ratio": median(lambda row: row["ratio"]),
        "median_cpu_s": [median(lambda row: row["upswing"]["cpu_s"]), median(lambda row: row["fatrop"]["cpu_s"])],
        "median_iterations": [
            median(lambda row: row["upswing"]["iterations"]),
            median(lambda row: row["fatrop"]["iterations"]),
        ],
        "largest_difference": largest(lambda row: row["difference"]),
        "largest_state_difference": largest(lambda row: row["state_difference"]),
        "largest_violation": largest(lambda row: max(v for key, v in row["audit"].items() if key != "cost")),
    }


def print_fatrop_summary(s: dict):
    print(f"\nFATROP solved {s['solved_by_fatrop']} of {s['starts']}; the same optimum as upswing's first solution: {s['same_optimum']}")
    if s["same_optimum"]:
        (ours, theirs), (our_iterations, their_iterations) = s["median_cpu_s"], s["median_iterations"]
        print(
            f"of those, medians: CPU time of the solver, upswing {1e3 * ours:.1f} ms, FATROP {1e3 * theirs:.0f} ms, ratio "
            f"{s['median_ratio']:.1f}; iterations {our_iterations:g}, FATROP {their_iterations:g}\n"
            f"largest difference of a cost {s['largest_difference']:.1e} (relative), of a state {s['largest_state_difference']:.1e}; "
            f"largest violation of FATROP's solutions in the peer's model {s['largest_violation']:.1e}"
        )


HEADER = (
    f"{'start: q_A (: given), deg or m':>42} | {'cost':^35} | {'t_F, s':^13} | {'swings':^11} | {'time, s':^31} | {'ratio':>6}\n"
    f"{'':>42} | {'first':>8} {'best':>8} {'IPOPT':>8} {'above %':>8} | {'ours':>6} {'IPOPT':>6} | {'ours':>5} {'IPOPT':>5} |"
    f" {'first':>6} {'best':>6} {'IPOPT':>6} {'all':>10} |"
)


def table_line(row: dict) -> str:
    first, ours, theirs = row["upswing_first"], row["upswing"], row["ipopt"]

    def number(value, form, missing="-"):
        return missing if value is None else format(value, form)

    def cost(run):
        return f"{run['cost']:.5f}" if run["status"] == "solved" else "failed"

    best = theirs["best"] or {}
    start = ",".join(f"{v:.3g}" for v in row["start_shown"])
    if row["given_shown"]:
        start += ":" + ",".join(f"{v:.3g}" for v in row["given_shown"])
    times = f"{theirs['cpu_s']:.1f} ({theirs['guesses']})"
    return (
        f"{start:>42} | {cost(first):>8} {cost(ours):>8} {number(best.get('cost'), '.5f', 'failed'):>8}"
        f" {number(row['excess_percent'], '.3f'):>8} |"
        f" {ours['t_f']:6.3f} {number(best.get('t_f'), '.3f'):>6} |"
        f" {'/'.join(map(str, ours['swings'])):>5} {'/'.join(map(str, row['ipopt_swings'] or [])):>5} |"
        f" {first['cpu_s']:6.3f} {ours['cpu_s']:6.2f} {number(theirs['first_cpu_s'], '.2f'):>6} {times:>10} |"
        f" {number(row['ratio'], '.1f'):>6}"
    )


def summarise(rows: list[dict]) -> dict:
    def median(values):
        known = [v for v in values if v is not None]
        return statistics.median(known) if known else None

    excesses = [row["excess_percent"] for row in rows]
    firsts = [row["first_excess_percent"] for row in rows]
    differences = [row["difference_percent"] for row in rows if row["difference_percent"] is not None]
    solved = [e for e in excesses if e is not None]
    close = sum(e <= CLOSE for e in solved)
    largest = max(solved, default=None)
    return {
        "starts": len(rows),
        "solved_by_upswing": len(solved),
        "solved_by_ipopt": sum(row["ipopt"]["best"] is not None for row in rows),
        "close_to_lowest": close,
        "largest_excess_percent": largest,
        "first_close_to_lowest": sum(e is not None and e <= CLOSE for e in firsts),
        "largest_first_excess_percent": max((e for e in firsts if e is not None), default=None),
        "ipopt_above_lowest": sum(d < -CLOSE for d in differences),
        "passed": close >= SHARE * len(rows) and len(solved) == len(rows) and largest <= LARGEST,
        "median_ratio": median(row["ratio"] for row in rows),
        "median_first_cpu_s": median(row["upswing_first"]["cpu_s"] for row in rows),
        "median_first_time_s": median(row["upswing_first"]["time_s"] for row in rows),
        "median_best_cpu_s": median(row["upswing"]["cpu_s"] for row in rows),
        "median_ipopt_cpu_s": median(row["ipopt"]["first_cpu_s"] for row in rows),
        "median_ipopt_all_cpu_s": median(row["ipopt"]["cpu_s"] for row in rows),
        "median_iterations": [
            median(row["upswing_first"]["iterations"] for row in rows),
            median(row["ipopt"]["first_iterations"] for row in rows),
        ],
        "ipopt_solutions_per_guess": sum(row["ipopt"]["solved"] for row in rows)
        / sum(row["ipopt"]["guesses"] for row in rows),
        "audit": {
            key: max((row["audit"][key] for row in rows if row["upswing"]["status"] == "solved"), default=None)
            for key in rows[0]["audit"]
            if key != "cost"
        },
    }


def print_summary(s: dict):
    print(f"\nsolved: {s['solved_by_upswing']} of {s['starts']} by upswing, {s['solved_by_ipopt']} by IPOPT")
    if not s["solved_by_upswing"]:
        return
    print(
        f"cost of upswing's search above the lowest known: at most {CLOSE} % at {s['close_to_lowest']} of {s['starts']} starts, "
        f"largest {s['largest_excess_percent']:.3f} %: {'passed' if s['passed'] else 'NOT PASSED'}\n"
        f"  of its first solution: at most {CLOSE} % at {s['first_close_to_lowest']}, "
        f"largest {s['largest_first_excess_percent']:.3f} %; of IPOPT's best: more than {CLOSE} % at {s['ipopt_above_lowest']}"
    )
    if s["median_ratio"] is not None:
        print(
            f"first solution, medians: CPU time upswing {s['median_first_cpu_s']:.3f} s (solver {s['median_first_time_s']:.4f} s), "
            f"IPOPT {s['median_ipopt_cpu_s']:.2f} s, ratio {s['median_ratio']:.1f}; iterations "
            f"{s['median_iterations'][0]:g}, IPOPT {s['median_iterations'][1]:g}\n"
            f"whole search, medians: upswing {s['median_best_cpu_s']:.3f} s, IPOPT {s['median_ipopt_all_cpu_s']:.2f} s; "
            f"{100 * s['ipopt_solutions_per_guess']:.0f} % of IPOPT's guesses converge"
        )
    a = s["audit"]
    print(
        "upswing's solutions in the peer's model, largest of all: "
        f"defect {a['defect']:.1e}, start {a['start']:.1e}, target {a['target']:.1e},\n"
        f"  beyond a limit: position {a['position']:.1e}, velocity {a['velocity']:.1e}, "
        f"torque {a['torque']:.1e}, t_F {a['t_f']:.1e} (rad or m, N m or N, s)"
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
        "gcc_flags": {"ipopt": ipopt.C_FLAGS, "fatrop": fatrop.C_FLAGS},
        "fatrop_options": fatrop.OPTIONS,
    }


def compare_with_ipopt(
    upswing: Path, folder: Path, peer: Peer, starts: list[Start], fingerprint: str, options: argparse.Namespace
) -> dict:
    problems = {"fingerprint": fingerprint, "starts": [problem(start) for start in starts]}
    if options.keep and options.keep.exists():
        results = kept_results(options.keep, problems)
    else:
        results = solve_with_ipopt(peer, starts, options)
        if options.keep:
            kept = problems | {"ipopt": [asdict(result) for result in results]}
            options.keep.write_text(json.dumps(kept) + "\n")
    print(
        "first, best: our first solution and that of our search; above: excess of the latter over the lowest cost known;\n"
        "time: CPU time, of our whole process, of IPOPT until its first solution, and for all guesses (their number);\n"
        "ratio = IPOPT until its first solution / our first\n"
    )
    print(HEADER, flush=True)
    rows = []
    for start, result in zip(starts, results, strict=True):
        rows.append(compare(upswing, folder, peer, start, result))
        print(table_line(rows[-1]), flush=True)
    summary = summarise(rows)
    print_summary(summary)
    return {"summary": summary, "problems": rows}


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
        "system": options.system,
        "torque": options.torque,
        "core": core,
    }
    with tempfile.TemporaryDirectory() as temporary:
        folder = settings_folder(upswing, options.system, options.torque, Path(temporary))
        peer = Peer(folder, options.torque, options.manoeuvre, ROOT / "bench" / ".cache")
        if options.grid:
            starts = peer.grid_starts(options.grid, options.points, options.seed)
        else:
            starts = peer.random_starts(options.points, options.seed)
        fingerprint = hashlib.sha256(repr((peer.chain, peer.limits, peer.manoeuvre.coefficients)).encode()).hexdigest()[:16]
        report |= {"manoeuvre": peer.manoeuvre.name, "fingerprint": fingerprint, "seed": options.seed}
        check_model(upswing, folder, peer)
        print(f"CasADi {ca.__version__}, {report['versions']['ipopt']}")
        print(f"{options.system}, {peer.manoeuvre.name}; core {core}, torque constraint: {options.torque}")
        if options.peers != "ipopt":
            fatrop_peer = Fatrop(peer, options.torque, ROOT / "bench" / ".cache")
            outside, rows = seconds_without_solving(upswing, folder, peer), []
            print(f"FATROP from upswing's first guess, {TURNS} turns; CPU times of the solvers alone", flush=True)
            for start in starts:
                rows.append(compare_with_fatrop(upswing, folder, peer, fatrop_peer, start, outside))
                print(fatrop_line(rows[-1]), flush=True)
            report |= {"fatrop_summary": summarise_fatrop(rows), "fatrop_problems": rows}
            print_fatrop_summary(report["fatrop_summary"])
        if options.peers != "fatrop":
            report |= compare_with_ipopt(upswing, folder, peer, starts, fingerprint, options)
    if options.json:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    try:
        main()
    except ValueError as error:
        sys.exit(f"error: {error}")
