"""Solves the QPs (16) that `bench-replan solvers` has written with HPIPM and PIQP, on one core, and compares times and solutions.

Started by bench/replan/run, which sets up everything this needs.
"""

import sys
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

import numpy as np
import hpipm
import piqp
import scipy.sparse as sp

TOLERANCE = 1e-9
COMPLEMENTARITY = 1e-12
"""As in solvers.rs: residuals, and mean product of a distance to a bound and its multiplier."""
LARGEST_DIFFERENCE = 1e-5
"""Of states from the reference, rad and rad/s."""
PIQP = {
    "PIQP, sparse_multistage": piqp.KKTSolver.sparse_multistage,
    "PIQP, sparse_ldlt": piqp.KKTSolver.sparse_ldlt,
}
HPIPM = {
    "HPIPM, SPEED_ABS": hpipm.SPEED_ABS,
    "HPIPM, BALANCE": hpipm.BALANCE,
}
HPIPM_SETTINGS = {"mu0": 1e-2, "tol_stat": 1e-6, "tol_eq": TOLERANCE, "tol_ineq": TOLERANCE}
"""The fastest of the barriers 1 to 1e-3; none of its other settings makes it faster. SPEED_ABS ends by the mean product alone."""
HPIPM_COMPLEMENTARITY = {
    ("first", hpipm.SPEED_ABS): 1e-12,
    ("first", hpipm.BALANCE): 1e-10,
    ("second", hpipm.SPEED_ABS): 3e-13,
    ("second", hpipm.BALANCE): 1e-10,
}
"""The largest with which all states are within the largest difference."""


class Record:
    """Reads one record of the file, see bench/replan/qps.rs."""

    def __init__(self, numbers: np.ndarray):
        self.numbers, self.at = numbers, 0

    def take(self, *shape: int) -> np.ndarray:
        count = int(np.prod(shape))
        part = self.numbers[self.at : self.at + count].reshape(shape)
        if part.size != count:
            sys.exit("error: a record of the file of QPs is too short")
        self.at += count
        return part


class Solved:
    """What one of upswing's solvers took and found."""

    def __init__(self, record: Record, n: int, nz: int):
        self.cpu, self.wall, self.iterations = record.take(3)
        self.z = record.take(n + 1, nz)


class Problem:
    """min 1/2 v' P v + c' v subject to A v = b, h_l <= G v <= h_u, x_l <= v <= x_u for v = (z_0..z_N, dt)."""

    def __init__(self, record: Record, n: int, nx: int, nu: int, targets: int):
        nq, nz = nx // 2, nx + nu
        self.nx = nx
        self.ours, self.clarabel = Solved(record, n, nz), Solved(record, n, nz)
        self.reference = record.take(n + 1, nz)
        h, weight_t, gradient_t, t_min, t_max = record.take(5)
        weight, gradient = record.take(n + 1, nz), record.take(n + 1, nz)
        rate, f = np.zeros((n + 1, nx, nz)), np.zeros((n + 1, nx))
        rate[:, :nq, nq:nx] = np.eye(nq)
        rate[:, nq : nq + nu, nx:] = np.eye(nu)
        for k in range(n + 1):
            rate[k, nq + nu :, :nx] = record.take(nq - nu, nx)
            rate[k, nq + nu :, nx:] = record.take(nq - nu, nu)
            f[k] = record.take(nx)
        defects, start = record.take(n, nx), record.take(nx)
        target = record.take(targets, nx + 1)
        bounds = record.take(n, 2, nx)

        self.h, self.rate, self.f, self.defects = h, rate, f, defects
        self.start, self.target, self.bounds = start, target, bounds
        self.weight, self.gradient = weight, gradient
        self.weight_t, self.gradient_t, self.t_bounds = weight_t, gradient_t, (t_min, t_max)

        self.P = sp.diags(np.append(weight.ravel(), weight_t)).tocsc()
        self.c = np.append(gradient.ravel(), gradient_t)
        state = np.eye(nx, nz)
        # (14): -(I + h/2 rate_k) z_k + (I - h/2 rate_{k+1}) z_{k+1} - dt (f_k + f_{k+1}) / (2 N) = -r_k
        near = sp.block_diag([-state - h / 2 * r for r in rate[:-1]])
        far = sp.block_diag([state - h / 2 * r for r in rate[1:]])
        none = sp.csc_matrix((n * nx, nz))
        along_t = sp.csc_matrix(-(f[:-1] + f[1:]).reshape(-1, 1) / (2 * n))
        dynamics = sp.hstack([sp.hstack([near, none]) + sp.hstack([none, far]), along_t])
        width = (n + 1) * nz + 1
        first = sp.eye(nx, width)
        last = sp.lil_matrix((targets, width))
        last[:, n * nz : n * nz + nx] = target[:, :nx]
        self.A = sp.vstack([first, dynamics, last]).tocsc()
        self.A.eliminate_zeros()
        self.b = np.concatenate([start, -defects.ravel(), target[:, nx]])

        self.x_l, self.x_u = np.full(width, -np.inf), np.full(width, np.inf)
        for k in range(n):
            at = (k + 1) * nz
            self.x_l[at : at + nx], self.x_u[at : at + nx] = bounds[k]
        self.x_l[-1], self.x_u[-1] = t_min, t_max

        jacobian, lower, upper = [], [], []
        for _ in range(n + 1):
            j, low, high = record.take(nu, nz), record.take(nu), record.take(nu)
            # In units of half the range, as Clarabel gets them.
            scale = 2 / (high - low)
            jacobian.append(scale[:, None] * j)
            lower.append(scale * low)
            upper.append(scale * high)
        self.jacobian, self.torque_bounds = np.array(jacobian), np.array([lower, upper]).transpose(1, 0, 2)
        self.G = sp.hstack([sp.block_diag(jacobian), sp.csc_matrix(((n + 1) * nu, 1))]).tocsc()
        self.h_l, self.h_u = np.concatenate(lower), np.concatenate(upper)
        self.inequalities = 2 * (n * nx + (n + 1) * nu + 1)

    def difference(self, z: np.ndarray) -> float:
        """Largest difference of states from the reference, rad or rad/s."""
        return float(np.abs(z - self.reference)[:, : self.nx].max())


def read(path: Path) -> Iterator[Problem]:
    numbers = np.fromfile(path, "<f8")
    if numbers.size < 5:
        sys.exit(f"error: {path}: expected QPs, got {numbers.size} numbers")
    n, nx, nu, targets = numbers[:4].astype(int)
    rest = numbers[4:]
    while rest.size:
        record = Record(rest)
        yield Problem(record, n, nx, nu, targets)
        rest = rest[record.at :]


def timed(work) -> np.ndarray:
    """CPU time of this thread and wall time, s."""
    before = np.array([time.thread_time(), time.perf_counter()])
    work()
    return np.array([time.thread_time(), time.perf_counter()]) - before


def by_piqp(p: Problem, kkt_solver) -> dict:
    solver = piqp.SparseSolver()
    s = solver.settings
    s.kkt_solver = kkt_solver
    s.eps_abs = s.eps_rel = TOLERANCE
    # The gap is the sum of all products.
    s.eps_duality_gap_abs, s.eps_duality_gap_rel = COMPLEMENTARITY * p.inequalities, 0
    setup = timed(lambda: solver.setup(p.P, p.c, p.A, p.b, p.G, p.h_l, p.h_u, p.x_l, p.x_u))
    solving = timed(solver.solve)
    result = solver.result
    return {
        "solved": result.info.status == piqp.PIQP_SOLVED,
        "with set-up": setup + solving,
        "without": solving,
        "iterations": result.info.iter,
        "difference": p.difference(result.x[:-1].reshape(p.reference.shape)),
    }


def by_hpipm(p: Problem, mode: int, complementarity: float) -> dict:
    solver = hpipm.Solver(hpipm.stages(p), mode, HPIPM_SETTINGS | {"tol_comp": complementarity})
    # Once before: the first solve in new memory waits for its pages.
    solver.solve()
    solving = timed(solver.solve)
    return {
        "solved": solver.solved,
        "without": solving,
        "iterations": solver.iterations,
        "difference": p.difference(solver.z(p)),
    }


HEADER = (
    f"{'':<36} | {'CPU time, ms':^17} | {'wall time, ms':^17} | {'iterations':^11} | {'ratio of':^8} | difference\n"
    f"{'one QP':<36} | {'median':>8} {'p99':>8} | {'median':>8} {'p99':>8} | {'median':>6} {'max':>4} |"
    f" {'CPU time':^8} | of states"
)


def line(name: str, times, iterations, ours, difference: float | None) -> str:
    """`times`: CPU and wall, s, per QP; `ours`: upswing's CPU times."""
    times = np.array(times)
    cpu, wall = 1e3 * np.median(times, axis=0)
    cpu99, wall99 = 1e3 * np.percentile(times, 99, axis=0, method="inverted_cdf")
    ratio = np.median(times[:, 0] / ours)
    return (
        f"{name:<36} | {cpu:8.2f} {cpu99:8.2f} | {wall:8.2f} {wall99:8.2f} |"
        f" {np.median(iterations):6g} {np.max(iterations):4g} | {ratio:8.2f} |"
        + ("" if difference is None else f" {difference:.0e}")
    )


def compare(which: str, title: str, path: Path) -> tuple[float, int]:
    """Prints a table; the largest difference of a state, and the number of QPs that a peer did not solve."""
    rows = []
    for p in read(path):
        results = {name: by_hpipm(p, mode, HPIPM_COMPLEMENTARITY[which, mode]) for name, mode in HPIPM.items()}
        results |= {name: by_piqp(p, kkt_solver) for name, kkt_solver in PIQP.items()}
        rows.append((p, results))
    problems = [p for p, _ in rows]
    ours = np.array([p.ours.cpu for p in problems])
    print(f"\n{which} QP of a replan, {title}: {len(rows)} QPs\n{HEADER}")
    worst, failures = 0.0, 0
    for name, solved in [
        ("upswing, structured", [p.ours for p in problems]),
        ("Clarabel, with set-up", [p.clarabel for p in problems]),
    ]:
        difference = max(p.difference(s.z) for p, s in zip(problems, solved))
        print(line(name, [(s.cpu, s.wall) for s in solved], [s.iterations for s in solved], ours, difference))
        worst = max(worst, difference)
    for name in [*HPIPM, *PIQP]:
        results = [r[name] for _, r in rows]
        iterations = [r["iterations"] for r in results]
        difference = max((r["difference"] for r in results if r["solved"]), default=np.inf)
        for part in ("with set-up", "without"):
            if part in results[0]:
                print(line(f"{name}, {part}", [r[part] for r in results], iterations, ours, difference))
        unsolved = sum(not r["solved"] for r in results)
        if unsolved:
            print(f"  {unsolved} of {len(results)} not solved to the tolerance")
        failures += unsolved
        worst = max(worst, difference)
    return worst, failures


def main():
    folder = Path(sys.argv[1])
    print(f"\nHPIPM of acados {version('comma-deps-acados')}, {hpipm.target()}; PIQP {piqp.__version__}")
    tables = [
        compare("first", "from cold", folder / "first.bin"),
        compare("second", "upswing from the multipliers of the first", folder / "second.bin"),
    ]
    print()
    worst, failures = max(w for w, _ in tables), sum(f for _, f in tables)
    if not worst <= LARGEST_DIFFERENCE:
        sys.exit(f"error: a solution is off by {worst:.1e} rad or rad/s, expected at most {LARGEST_DIFFERENCE:.0e}")
    if failures:
        sys.exit(f"error: the peers left {failures} QPs unsolved")


if __name__ == "__main__":
    main()
