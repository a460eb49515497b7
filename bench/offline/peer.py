"""The problem (6), (8) with the torque constraint (9) or (11) for IPOPT, with exact derivatives compiled to C.

Derivatives are built knot by knot (a dense Hessian of one knot's variables each), which is faster to evaluate than what
CasADi derives from the whole problem: the peer is not slowed down by a careless formulation.
"""

import contextlib
import hashlib
import io
import itertools
import resource
import subprocess
import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np

from model import Chain, acceleration, inverse_dynamics, motor_torque, motor_torque_without_coriolis, read_chain

STRAIGHT = (3.5, 5.0, 2.5)
"""Durations of the straight lines that are tried first, in half periods of the slowest swing of the hanging unactuated joints."""
WAVES = (1.2, 8.0)
"""Shortest and longest duration of the lines with random waves, in the same unit."""
SWING = ((1.5, 2.5), (1.0, 3.0))
"""Half swings and half periods of the guess that upswing tries first; the second pair where more joints are actuated than not."""
SAME = 1e-3
"""Costs that differ by less than this share count as the same optimum."""
ENOUGH = 3
"""How often the cheapest optimum is found before no further guess is tried."""
ROUNDS = 5
"""How often results at neighbouring starts are used as guesses, as long as they become cheaper."""
TOLERANCE = 1e-8
"""Largest constraint violation and optimality error that IPOPT accepts."""
MAX_ITERATIONS = 500
"""Of one guess; where it takes more, another guess is the better use of the time."""
C_FLAGS = ["-O2", "-fPIC", "-shared"]


def per_joint(table: dict, keys: tuple[str, str], chain: Chain, joints: list[int]) -> np.ndarray:
    """A setting of `joints` in rad or m: by the key for revolute joints (deg) or that for prismatic ones (m); each is a value for
    all of them or a table by joint name."""
    values = []
    for joint in (chain.joints[i] for i in joints):
        of_kind = table.get(keys[joint.prismatic], 0.0)
        value = of_kind.get(joint.name, of_kind.get("default")) if isinstance(of_kind, dict) else of_kind
        values.append(np.array(value, float) if joint.prismatic else np.radians(value))
    return np.array(values)


def by_name(value, names: list[str]) -> np.ndarray:
    """A setting with one value for all joints, or a table by joint name."""
    table = value if isinstance(value, dict) else {"default": value}
    return np.array([table[name] if name in table else table["default"] for name in names], float)


def position(entry: dict, key: str) -> float:
    """The position under `key`_deg or `key`_m, rad or m."""
    return entry[f"{key}_m"] if f"{key}_m" in entry else np.radians(entry[f"{key}_deg"])


def axis_range(entry: dict) -> tuple[float, float]:
    """Lowest and highest position of an axis of a grid, rad or m."""
    if "value_deg" in entry or "value_m" in entry:
        return (position(entry, "value"),) * 2
    return position(entry, "from"), position(entry, "to")


@dataclass
class Limits:
    """What a plan may use, and the weight of the cost, from the files that upswing reads; rad or m."""

    q_min: np.ndarray
    q_max: np.ndarray
    qd_max: np.ndarray
    tau_lower: np.ndarray
    tau_upper: np.ndarray
    input_weight: float
    t_f: tuple[float, float]
    intervals: int

    @classmethod
    def read(cls, folder: Path, chain: Chain, torque: str):
        robot = tomllib.loads((folder / "robot.toml").read_text())
        offline = tomllib.loads((folder / "planner.toml").read_text())["offline"]
        rated, usage = robot["limits"], robot["usage"]
        every = list(range(chain.n))
        q = per_joint(rated, ("q_deg", "q_m"), chain, every)
        margin = per_joint(usage, ("position_margin_deg", "position_margin_m"), chain, chain.unactuated)
        q[chain.unactuated] += margin[:, None] * [-1, 1]
        kept = 0.5 * (1 - usage.get("position_fraction_actuated", 1.0)) * (q[:, 1] - q[:, 0])[chain.actuated]
        q[chain.actuated] += kept[:, None] * [1, -1]
        share = np.full(chain.n, usage["velocity_fraction_actuated"])
        share[chain.unactuated] = usage["velocity_fraction_unactuated"]

        motors = [chain.names[i] for i in chain.actuated]
        tau = by_name(rated["tau_nm"], motors) * usage["torque_fraction"]
        c = robot.get("coriolis_bound") if torque == "paper" else None
        return cls(
            q_min=q[:, 0],
            q_max=q[:, 1],
            qd_max=per_joint(rated, ("qd_deg_s", "qd_m_s"), chain, every) * share,
            tau_lower=-tau - (by_name(c["lower_nm"], motors) if c else 0.0),
            tau_upper=tau - (by_name(c["upper_nm"], motors) if c else 0.0),
            input_weight=offline["input_weight"],
            t_f=(offline["t_f_min_s"], offline["t_f_max_s"]),
            intervals=offline["intervals"],
        )


@dataclass
class Start:
    """A problem: where it starts and what the request gives. rad or m."""

    x: np.ndarray
    """[q, qd] at rest."""
    given: dict[str, float]
    """Positions of the target by joint."""
    rows: np.ndarray
    """Values of the target's rows."""


@dataclass
class Manoeuvre:
    """Start posture and target (8) of a manoeuvre, from manoeuvres.toml."""

    name: str
    standing: bool
    rows: list[dict]
    coefficients: np.ndarray
    """Of q_N, a row for each of the target."""
    grid: list[dict]
    max_rest: float
    """rad or m"""

    @classmethod
    def read(cls, folder: Path, chain: Chain, name: str | None):
        every = tomllib.loads((folder / "manoeuvres.toml").read_text())["manoeuvre"]
        found = [m for m in every if name in (None, m["name"]) and "reverses" not in m]
        if not found:
            raise ValueError(f"manoeuvres.toml: no manoeuvre {name} with a target")
        table = found[0]
        coefficients = np.zeros((len(table["target"]), chain.n))
        for row, entry in zip(coefficients, table["target"], strict=True):
            for joint, value in entry.get("coefficients", {entry.get("joint"): 1.0}).items():
                row[chain.names.index(joint)] = value
        return cls(
            name=table["name"],
            standing=table["start"] == "standing",
            rows=table["target"],
            coefficients=coefficients,
            grid=table["grid"],
            max_rest=np.radians(table.get("max_rest_angle_deg", np.inf)),
        )


@dataclass
class Solution:
    """A solution of IPOPT."""

    cost: float
    t_f: float
    x: list[list[float]]
    """States at the knots."""
    u: list[list[float]]


@dataclass
class Result:
    """What IPOPT found from all guesses of a start."""

    best: Solution | None = None
    guesses: int = 0
    """How many were tried."""
    solved: int = 0
    """How many of them converged."""
    costs: list[float] = field(default_factory=list)
    """Of those."""
    first_cpu_s: float | None = None
    """Until the first solution, failed guesses before it included."""
    first_iterations: int | None = None
    cpu_s: float = 0.0
    """Of all guesses."""

    def found(self) -> int:
        """How often the cheapest optimum was found."""
        return sum(cost <= self.best.cost * (1 + SAME) for cost in self.costs) if self.best else 0


def cpu_seconds(who) -> float:
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


class Peer:
    """The problem of every start, built and compiled once. Variables: t_F, then x_k and u_k of each knot."""

    def __init__(self, folder: Path, torque: str, manoeuvre: str | None, cache: Path):
        self.chain = read_chain(folder / "robot.urdf")
        bearings = tomllib.loads((folder / "robot.toml").read_text()).get("bearings", {})
        unactuated = [self.chain.joints[i] for i in self.chain.unactuated]
        friction = by_name(bearings.get("friction_viscous", 0.0), [joint.name for joint in unactuated])
        for joint, viscous in zip(unactuated, friction, strict=True):
            joint.viscous = float(viscous)
        self.limits = limits = Limits.read(folder, self.chain, torque)
        self.manoeuvre = Manoeuvre.read(folder, self.chain, manoeuvre)
        self.tau_centre = (limits.tau_lower + limits.tau_upper) / 2
        self.tau_half = (limits.tau_upper - limits.tau_lower) / 2
        # Rows of one joint fix a variable; the others are constraints.
        sums = (self.manoeuvre.coefficients != 0).sum(axis=1) > 1
        self.sums, self.fixed = np.flatnonzero(sums), np.flatnonzero(~sums)
        self._check_functions()
        self._knot_functions(torque)
        functions = self._problem_functions()
        library = compile_functions(functions, cache, C_FLAGS)
        nlp, grad_f, jac_g, hess_lag = (ca.external(f.name(), str(library)) for f in functions)
        options = {
            "grad_f": grad_f,
            "jac_g": jac_g,
            "hess_lag": hess_lag,
            # Needed only for multipliers that nobody reads here.
            "no_nlp_grad": True,
            "print_time": False,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.linear_solver": "mumps",
            "ipopt.tol": TOLERANCE,
            "ipopt.constr_viol_tol": TOLERANCE,
            # No "solved to acceptable level": converged or not.
            "ipopt.acceptable_iter": 0,
            "ipopt.max_iter": MAX_ITERATIONS,
        }
        self.solver = ca.nlpsol("manoeuvre", "ipopt", nlp, options)

    def _check_functions(self):
        """Functions to compare with `upswing model eval`, and for the equilibria of the unactuated joints."""
        chain, n, n_a = self.chain, self.chain.n, self.chain.n_a
        q, qd, u, qdd = (ca.SX.sym(name, k) for name, k in (("q", n), ("qd", n), ("u", n_a), ("qdd", n)))
        zero = ca.SX.zeros(n)
        mass = ca.jacobian(inverse_dynamics(chain, q, zero, qdd), qdd)
        gravity = inverse_dynamics(chain, q, zero, zero)
        self.model = ca.Function(
            "model",
            [q, qd, u],
            [
                mass,
                inverse_dynamics(chain, q, qd, zero) - ca.DM([joint.viscous for joint in chain.joints]) * qd,
                gravity,
                ca.vertcat(qd, acceleration(chain, q, qd, u)),
                motor_torque(chain, q, qd, u),
                motor_torque_without_coriolis(chain, q, u),
            ],
            ["q", "qd", "u"],
            ["M", "nle", "g", "f", "tau", "tau_without_coriolis"],
        )
        unactuated = gravity[chain.unactuated]
        curvature = ca.jacobian(unactuated, q[chain.unactuated])
        m_uu = ca.densify(mass[chain.unactuated, chain.unactuated])
        self._unactuated = ca.Function("unactuated", [q], [unactuated, ca.densify(curvature), m_uu])

    def rest(self, q: np.ndarray) -> np.ndarray | None:
        """The position at which the unactuated joints hang, from those in `q`: Newton's method with the curvature of the potential made
        positive; None if it does not converge."""
        q = q.copy()
        for _ in range(200):
            residual, curvature, _ = (v.full() for v in self._unactuated(q))
            if np.abs(residual).max() < 1e-13:
                break
            values, vectors = np.linalg.eigh((curvature + curvature.T) / 2)
            values = np.maximum(np.abs(values), 1e-6 * np.abs(values).max())
            step = -vectors @ ((vectors.T @ residual.ravel()) / values)
            q[self.chain.unactuated] += step * min(1.0, 0.5 / np.abs(step).max())
        residual, curvature, _ = (v.full() for v in self._unactuated(q))
        return q if np.abs(residual).max() < 1e-10 and np.linalg.eigvalsh(curvature).min() > 0 else None

    def half_period(self, q: np.ndarray) -> float:
        """Half a period of the slowest swing of the unactuated joints where they hang near `q`, s."""
        hanging = self.rest(q)
        if hanging is None:
            return 1.0
        _, curvature, m_uu = (v.full() for v in self._unactuated(hanging))
        slowest = np.linalg.eigvals(np.linalg.solve(m_uu, curvature)).real.min()
        return np.pi / np.sqrt(slowest) if slowest > 0 else 1.0

    def nearest(self, rows: np.ndarray, values: np.ndarray, q: np.ndarray) -> np.ndarray:
        """The position nearest to `q` with these values of rows."""
        return q + np.linalg.pinv(rows) @ (values - rows @ q)

    def target(self, given: dict[str, float]) -> np.ndarray | None:
        """Values of the target's rows, rad or m; None if the unactuated joints do not hang where they should."""
        rows, coefficients = self.manoeuvre.rows, self.manoeuvre.coefficients
        known = np.array([not row.get("rest", False) for row in rows])
        values = np.zeros(len(rows))
        for i in np.flatnonzero(known):
            values[i] = given[rows[i]["joint"]] if rows[i].get("given", False) else position(rows[i], "value")
        if not known.all():
            rest = self.rest(self.nearest(coefficients[known], values[known], np.zeros(self.chain.n)))
            if rest is None:
                return None
            values[~known] = coefficients[~known] @ rest
        return values

    def start(self, q_a: np.ndarray, given: dict[str, float]) -> Start | None:
        """The problem from the pose q_A of the actuated joints; None if the unactuated ones do not rest there within their limits."""
        chain, manoeuvre, limits = self.chain, self.manoeuvre, self.limits
        q = np.zeros(chain.n)
        q[chain.actuated] = q_a
        rows = self.target(given)
        if rows is None:
            return None
        if manoeuvre.standing:
            for i in self.fixed:
                joint = int(np.flatnonzero(manoeuvre.coefficients[i])[0])
                if joint in chain.unactuated:
                    q[joint] = rows[i] / manoeuvre.coefficients[i, joint]
            residual, _, _ = self._unactuated(q)
            if np.abs(residual.full()).max() > 1e-9:
                return None
        else:
            q = self.rest(q)
            if q is None or np.abs(q[chain.unactuated]).max() > manoeuvre.max_rest:
                return None
        if not (np.all(limits.q_min <= q) and np.all(q <= limits.q_max)):
            return None
        return Start(np.concatenate([q, np.zeros(chain.n)]), given, rows)

    def random_starts(self, points: int, seed: int) -> list[Start]:
        """Random problems: poses uniform in the ranges of the manoeuvre's grid, what the request gives in those of its rows."""
        random = np.random.default_rng(seed)
        names, starts = self.chain.names, []
        for _ in range(1000 * points):
            q = np.zeros(self.chain.n)
            for entry in self.manoeuvre.grid:
                q[names.index(entry["joint"])] = random.uniform(*axis_range(entry))
            given = {
                row["joint"]: random.uniform(*axis_range(row)) for row in self.manoeuvre.rows if row.get("given", False)
            }
            start = self.start(q[self.chain.actuated], given)
            if start is not None:
                starts.append(start)
            if len(starts) == points:
                return starts
        raise ValueError(f"{self.manoeuvre.name}: found {len(starts)} starts at rest in the grid's ranges, expected {points}")

    def grid_starts(self, file: Path, points: int, seed: int) -> list[Start]:
        """The problems from a random choice of the poses of a grid, in its order; the request gives nothing."""
        axes = tomllib.loads(file.read_text())["grid"]
        joints = [self.chain.names.index(axis["joint"]) for axis in axes]
        starts = []
        for pose in itertools.product(*(np.linspace(*axis_range(axis), axis.get("points", 1)) for axis in axes)):
            q = np.zeros(self.chain.n)
            q[joints] = pose
            starts.append(self.start(q[self.chain.actuated], {}))
        starts = [start for start in starts if start is not None]
        if points > len(starts):
            raise ValueError(f"{file.name}: expected at most its {len(starts)} starts, got {points}")
        # Equal steps through the list would meet the same positions of the last joints again and again.
        return [starts[i] for i in sorted(np.random.default_rng(seed).choice(len(starts), points, replace=False))]

    def _knot_functions(self, torque):
        """f, scaled torque, and their derivatives at one knot."""
        chain, n, n_a, nx = self.chain, self.chain.n, self.chain.n_a, self.chain.nx
        N = self.limits.intervals
        x, u, t = ca.SX.sym("x", nx), ca.SX.sym("u", n_a), ca.SX.sym("t")
        q, qd, z = x[:n], x[n:], ca.vertcat(x, u)
        f = ca.vertcat(qd, acceleration(chain, q, qd, u))
        tau = motor_torque(chain, q, qd, u) if torque == "exact" else motor_torque_without_coriolis(chain, q, u)
        tau = (tau - ca.DM(self.tau_centre)) / ca.DM(self.tau_half)
        cost = t + t / (2 * N) * self.limits.input_weight * ca.sumsqr(u)
        self.values = ca.Function("values", [x, u], [f, tau], {"cse": True})
        self.first = ca.Function("first", [x, u], [f, tau, ca.jacobian(f, z), ca.jacobian(tau, z)], {"cse": True})
        # Terms of the Lagrangian at a knot: w sums the multipliers of the defects on both sides.
        w, mu, sigma = ca.SX.sym("w", nx), ca.SX.sym("mu", n_a), ca.SX.sym("sigma")
        lagrangian = sigma * (cost - t) - t / (2 * N) * ca.dot(w, f) + ca.dot(mu, tau)
        hessian, gradient = ca.hessian(lagrangian, z)
        with_t = ca.densify(ca.jacobian(gradient, t))
        self.second = ca.Function("second", [x, u, t, w, mu, sigma], [ca.triu(hessian), with_t], {"cse": True})

    def _problem_functions(self):
        n, n_a, nx, nz = self.chain.n, self.chain.n_a, self.chain.nx, self.chain.nz
        N, knots = self.limits.intervals, self.limits.intervals + 1
        v, p = ca.MX.sym("v", 1 + nz * knots), ca.MX.sym("p", 0)
        t, z = v[0], ca.reshape(v[1:], nz, knots)
        x, u = z[:nx, :], z[nx:, :]
        half_h, weight = t / (2 * N), self.limits.input_weight
        sums = ca.DM(self.manoeuvre.coefficients[self.sums])

        cost = t + half_h * weight * ca.sumsqr(u)
        f, tau = self.values.map(knots)(x, u)

        def constraints(f, tau):
            defects = x[:, 1:] - x[:, :-1] - half_h * (f[:, 1:] + f[:, :-1])
            return ca.vertcat(ca.vec(defects), ca.vec(tau), sums @ x[:n, N])

        nlp = ca.Function("nlp", [v, p], [cost, constraints(f, tau)], ["x", "p"], ["f", "g"])

        gradient = ca.vec(ca.vertcat(ca.MX.zeros(nx, knots), 2 * half_h * weight * u))
        on_t = 1 + weight * ca.sumsqr(u) / (2 * N)
        grad_f = ca.Function("nlp_grad_f", [v, p], [cost, ca.vertcat(on_t, gradient)], ["x", "p"], ["f", "grad_f_x"])

        f, tau, f_z, tau_z = self.first.map(knots)(x, u)
        f_z, tau_z = ca.horzsplit(f_z, nz), ca.horzsplit(tau_z, nz)
        identity = ca.horzcat(ca.DM.eye(nx), ca.DM(nx, n_a))
        gap = ca.MX(nx * N, nz)
        defects = ca.horzcat(ca.diagcat(*(-identity - half_h * a for a in f_z[:-1])), gap) + ca.horzcat(
            gap, ca.diagcat(*(identity - half_h * a for a in f_z[1:]))
        )
        rows = len(self.sums)
        jacobian = ca.vertcat(
            ca.horzcat(-ca.vec(f[:, 1:] + f[:, :-1]) / (2 * N), defects),
            ca.horzcat(ca.MX(n_a * knots, 1), ca.diagcat(*tau_z)),
            ca.horzcat(ca.MX(rows, 1 + nz * N), ca.sparsify(sums), ca.MX(rows, nz - n)),
        )
        jac_g = ca.Function("nlp_jac_g", [v, p], [constraints(f, tau), jacobian], ["x", "p"], ["g", "jac_g_x"])

        sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", nx * N + n_a * knots + rows)
        multipliers = ca.reshape(lam[: nx * N], nx, N)
        none = ca.MX.zeros(nx, 1)
        w = ca.horzcat(multipliers, none) + ca.horzcat(none, multipliers)
        mu = ca.reshape(lam[nx * N : nx * N + n_a * knots], n_a, knots)
        scalars = [ca.repmat(scalar, 1, knots) for scalar in (t, sigma)]
        blocks, with_t = self.second.map(knots)(x, u, scalars[0], w, mu, scalars[1])
        hessian = ca.vertcat(
            ca.horzcat(ca.MX(1, 1), ca.vec(with_t).T),
            ca.horzcat(ca.MX(nz * knots, 1), ca.diagcat(*ca.horzsplit(blocks, nz))),
        )
        hess_lag = ca.Function(
            "nlp_hess_l", [v, p, sigma, lam], [hessian], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        )
        return nlp, grad_f, jac_g, hess_lag

    def straight_line(self, start: Start, t_f: float) -> np.ndarray:
        """From the start to the nearest state of (8), zero velocities and inputs."""
        knots = self.limits.intervals + 1
        q = start.x[: self.chain.n]
        end = np.zeros(self.chain.nx)
        end[: self.chain.n] = self.nearest(self.manoeuvre.coefficients, start.rows, q)
        s = np.linspace(0, 1, knots)[:, None]
        return pack(t_f, start.x * (1 - s) + end * s, np.zeros((knots, self.chain.n_a)))

    def waves(self, start: Start, t_f: float, random: np.random.Generator) -> np.ndarray:
        """The same line with random half waves on all joints, within their limits; velocities and inputs are its derivatives."""
        chain, limits, knots = self.chain, self.limits, self.limits.intervals + 1
        q = self.straight_line(start, t_f)[1:].reshape(knots, chain.nz)[:, : chain.n]
        s = np.linspace(0, 1, knots)
        largest = np.minimum(limits.q_max - limits.q_min, 2 * np.pi) * 0.25
        for i in range(chain.n):
            for count in range(1, 1 + random.integers(1, 5)):
                q[:, i] += largest[i] / count * random.uniform(-1, 1) * np.sin(count * np.pi * s)
        q = np.clip(q, limits.q_min, limits.q_max)
        qd = np.clip(np.gradient(q, s * t_f, axis=0), -limits.qd_max, limits.qd_max)
        qd[[0, -1]] = 0
        u = np.gradient(qd, s * t_f, axis=0)[:, chain.actuated]
        return pack(t_f, np.hstack([q, qd]), u)

    def swing(self, start: Start) -> np.ndarray:
        """The guess that upswing tries first (`ocp/src/guess.rs`, `ocp/src/multistart.rs`): the actuated joints move to the target along a
        line, the unactuated ones swing there in time with their natural frequency; velocities and inputs are the derivatives."""
        chain, limits, knots = self.chain, self.limits, self.limits.intervals + 1
        half_swings, half_periods = SWING[chain.n_a > chain.n - chain.n_a]
        q = start.x[: chain.n]
        way = self.nearest(self.manoeuvre.coefficients, start.rows, q) - q
        shortest = np.abs(way / limits.qd_max)[chain.actuated].max()
        t_f = float(np.clip(max(half_periods * self.half_period(q), shortest), *limits.t_f))
        s = np.linspace(0, 1, knots)[:, None]
        line = (1 - np.cos(np.pi * s)) / 2
        line_d, line_dd = np.pi / 2 * np.sin(np.pi * s), np.pi**2 / 2 * np.cos(np.pi * s)
        phase = np.pi * half_swings * (1 - s)
        unactuated = np.isin(np.arange(chain.n), chain.unactuated)
        positions = q + way * line * np.where(unactuated, np.cos(phase), 1)
        swinging_d = line_d * np.cos(phase) + line * np.pi * half_swings * np.sin(phase)
        velocities = way * np.where(unactuated, swinging_d, line_d) / t_f
        velocities[0] = 0
        u = (way * line_dd / t_f**2)[:, chain.actuated]
        return pack(t_f, np.hstack([positions, velocities]), u)

    def guesses(self, start: Start, most: int, seed: int):
        """Straight lines, then lines with random waves."""
        q = start.x[: self.chain.n]
        random = np.random.default_rng(seed)
        way = self.nearest(self.manoeuvre.coefficients, start.rows, q) - q
        shortest = np.abs(way / self.limits.qd_max).max()
        half_period = self.half_period(q)

        def duration(half_periods):
            return float(np.clip(max(half_periods * half_period, shortest), *self.limits.t_f))

        for half_periods in STRAIGHT[:most]:
            yield self.straight_line(start, duration(half_periods))
        for _ in range(most - len(STRAIGHT)):
            yield self.waves(start, duration(np.exp(random.uniform(*np.log(WAVES)))), random)

    def shifted(self, start: Start, other: Start, solution: Solution) -> np.ndarray:
        """A solution of another start as a guess: its states are shifted linearly to this one's start and target."""
        n, knots = self.chain.n, self.limits.intervals + 1
        x, u = np.array(solution.x), np.array(solution.u)
        at_end = np.linalg.pinv(self.manoeuvre.coefficients) @ (start.rows - other.rows)
        s = np.linspace(0, 1, knots)[:, None]
        x[:, :n] += (start.x - other.x)[:n] * (1 - s) + at_end * s
        return pack(solution.t_f, x, u)

    def bounds(self, start: Start) -> tuple[np.ndarray, np.ndarray]:
        """Of the variables. The start and the rows of one joint of the target are fixed variables."""
        n, n_a, nx, nz = self.chain.n, self.chain.n_a, self.chain.nx, self.chain.nz
        N, knots = self.limits.intervals, self.limits.intervals + 1
        limits, free = self.limits, np.full((knots, n_a), np.inf)
        lower = pack(limits.t_f[0], np.tile(np.concatenate([limits.q_min, -limits.qd_max]), (knots, 1)), -free)
        upper = pack(limits.t_f[1], np.tile(np.concatenate([limits.q_max, limits.qd_max]), (knots, 1)), free)
        for bound in (lower, upper):
            bound[1 : 1 + nx] = start.x
            x_n = bound[1 + nz * N : 1 + nz * N + nx]
            x_n[n:] = 0
            for i in self.fixed:
                joint = int(np.flatnonzero(self.manoeuvre.coefficients[i])[0])
                x_n[joint] = start.rows[i] / self.manoeuvre.coefficients[i, joint]
        return lower, upper

    def attempt(self, start: Start, guess: np.ndarray, result: Result):
        """Runs IPOPT from a guess; its CPU time alone is counted."""
        chain = self.chain
        N, knots = self.limits.intervals, self.limits.intervals + 1
        lower, upper = self.bounds(start)
        equal, torque, sums = np.zeros(chain.nx * N), np.ones(chain.n_a * knots), start.rows[self.sums]
        lbg, ubg = np.concatenate([equal, -torque, sums]), np.concatenate([equal, torque, sums])
        before = cpu_seconds(resource.RUSAGE_SELF)
        solution = self.solver(x0=guess, p=[], lbx=lower, ubx=upper, lbg=lbg, ubg=ubg)
        result.cpu_s += cpu_seconds(resource.RUSAGE_SELF) - before
        result.guesses += 1
        stats = self.solver.stats()
        if not stats["success"]:
            return
        if result.solved == 0:
            result.first_cpu_s, result.first_iterations = result.cpu_s, stats["iter_count"]
        result.solved += 1
        cost = float(solution["f"])
        result.costs.append(cost)
        if result.best is None or cost < result.best.cost:
            v = solution["x"].full().ravel()
            z = v[1:].reshape(knots, chain.nz)
            result.best = Solution(cost, float(v[0]), z[:, : chain.nx].tolist(), z[:, chain.nx :].tolist())

    def solve(self, start: Start, least: int, most: int, seed: int) -> Result:
        """Runs IPOPT from at least `least` guesses, and until it has found the cheapest optimum ENOUGH times."""
        result = Result()
        for tried, guess in enumerate(self.guesses(start, most, seed)):
            if tried >= least and result.found() >= ENOUGH:
                break
            self.attempt(start, guess, result)
        return result

    def solve_from_neighbours(self, starts: list[Start], results: list[Result], count: int):
        """Runs IPOPT at each start from the cheapest solutions of the `count` nearest other starts, and again from those that have
        become cheaper by it."""
        keys = np.array([np.concatenate([start.x, start.rows]) for start in starts])
        solutions = [result.best for result in results]
        changed = {j for j, solution in enumerate(solutions) if solution is not None}
        for _ in range(ROUNDS):
            for i, result in enumerate(results):
                order = np.argsort(np.linalg.norm(keys - keys[i], axis=1), kind="stable")
                for j in order[order != i][:count]:
                    if j in changed:
                        self.attempt(starts[i], self.shifted(starts[i], starts[j], solutions[j]), result)
            changed = {
                j
                for j, (old, result) in enumerate(zip(solutions, results, strict=True))
                if result.best and (old is None or result.best.cost < old.cost * (1 - SAME))
            }
            solutions = [result.best for result in results]
            if not changed:
                break

    def audit(self, start: Start, t_f: float, x: np.ndarray, u: np.ndarray) -> dict[str, float]:
        """How far a trajectory (x: knots x nx, u: knots x n_a) is from meeting (6b), (6c), (8) and the torque
        constraint in this model, and its cost."""
        n = self.chain.n
        N, knots = self.limits.intervals, self.limits.intervals + 1
        limits = self.limits
        f, tau = (np.array(v).T for v in self.values.map(knots)(x.T, u.T))
        target = np.concatenate([self.manoeuvre.coefficients @ x[N, :n] - start.rows, x[N, n:]])

        def excess(values, lowest, highest):
            return float(np.maximum(np.maximum(values - highest, lowest - values), 0).max())

        return {
            "defect": float(np.abs(x[1:] - x[:-1] - t_f / (2 * N) * (f[1:] + f[:-1])).max()),
            "start": float(np.abs(x[0] - start.x).max()),
            "target": float(np.abs(target).max()),
            "position": excess(x[:, :n], limits.q_min, limits.q_max),
            "velocity": excess(x[:, n:], -limits.qd_max, limits.qd_max),
            "torque": excess(tau * self.tau_half + self.tau_centre, limits.tau_lower, limits.tau_upper),
            "t_f": max(limits.t_f[0] - t_f, t_f - limits.t_f[1], 0.0),
            "cost": t_f + t_f / (2 * N) * limits.input_weight * float((u**2).sum()),
        }


def pack(t_f, x, u) -> np.ndarray:
    """The vector of variables."""
    return np.concatenate([[t_f], np.hstack([x, u]).ravel()])


def compile_functions(functions, cache: Path, flags: list[str]) -> Path:
    """Shared library of the functions; compiled only if the cache has none of the same source."""
    generator = ca.CodeGenerator("manoeuvre.c")
    for function in functions:
        generator.add(function)
    source = generator.dump()
    key = hashlib.sha256(" ".join([ca.__version__, *flags, source]).encode()).hexdigest()[:16]
    library = cache / f"manoeuvre_{key}.so"
    if not library.exists():
        print("compiling the peer's functions ...", flush=True)
        cache.mkdir(parents=True, exist_ok=True)
        c_file = library.with_suffix(".c")
        c_file.write_text(source)
        unfinished = library.with_suffix(".tmp")
        subprocess.run(["gcc", *flags, "-o", str(unfinished), str(c_file), "-lm"], check=True)
        unfinished.rename(library)
    return library


def ipopt_version() -> str:
    """What IPOPT's banner says of itself and its linear solver."""
    v = ca.SX.sym("v")
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        ca.nlpsol("banner", "ipopt", {"x": v, "f": v**2}, {"print_time": False})(x0=1)
    lines = [line for line in text.getvalue().splitlines() if "Ipopt version" in line]
    return lines[0].removeprefix("This is ").rstrip(".") if lines else "unknown"
