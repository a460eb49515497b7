"""The problem (6), (8) with the torque constraint (9) or (11) for IPOPT, with exact derivatives compiled to C.

Derivatives are built knot by knot (a dense Hessian of one knot's variables each), which is faster to evaluate than what
CasADi derives from the whole problem: the peer is not slowed down by a careless formulation.
"""

import contextlib
import hashlib
import io
import resource
import subprocess
import tomllib
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from model import Chain, inverse_dynamics, motor_torque, motor_torque_without_coriolis, pendulum_acceleration, read_chain

GUESSES = (2.0, 3.0, 1.5)
"""Durations t_F of the straight lines tried, s: the first that converges counts."""
TOLERANCE = 1e-8
"""Largest constraint violation and optimality error that IPOPT accepts."""
C_FLAGS = ["-O2", "-fPIC", "-shared"]


def per_joint(value, names: list[str]) -> np.ndarray:
    """A setting with one value per joint: a value for all joints, or a table by joint name."""
    table = value if isinstance(value, dict) else {"default": value}
    return np.array([table[name] if name in table else table["default"] for name in names], float)


@dataclass
class Settings:
    """Limits, weights and target of (6), (8), from the files that upswing reads."""

    q_max: np.ndarray
    qd_max: np.ndarray
    tau_lower: np.ndarray
    tau_upper: np.ndarray
    input_weight: float
    t_f: tuple[float, float]
    max_iterations: int
    intervals: int
    pitch: float
    q8: float
    grid: list[dict]

    @classmethod
    def read(cls, folder: Path, chain: Chain, torque: str):
        robot = tomllib.loads((folder / "robot.toml").read_text())
        planner = tomllib.loads((folder / "planner.toml").read_text())
        limits, usage, offline = robot["limits"], robot["usage"], planner["offline"]
        names, n_a = [joint.name for joint in chain.joints], chain.n_a
        q_deg = per_joint(limits["q_deg"], names)
        if (q_deg[:, 0] != -q_deg[:, 1]).any():
            raise ValueError("limits.q_deg of robot.toml: expected ranges that are symmetric about 0")
        q_deg = q_deg[:, 1]
        q_deg[n_a:] += per_joint(usage["position_margin_deg"], names[n_a:])
        share = [usage["velocity_fraction_actuated"]] * n_a + [usage["velocity_fraction_unactuated"]] * (chain.n - n_a)
        tau = per_joint(limits["tau_nm"], names[:n_a]) * usage["torque_fraction"]
        bound = {
            key: per_joint(v, names[:n_a]) if torque == "paper" else 0.0 for key, v in robot["coriolis_bound"].items()
        }
        grid = tomllib.loads((folder / "grid-paper.toml").read_text())["grid"]
        # The target (8): the pitch of the flange is the only sum of joints.
        target = tomllib.loads((folder / "manoeuvres.toml").read_text())["manoeuvre"][0]["target"]
        pitch = next(row["value_deg"] for row in target if "coefficients" in row)
        q8 = next(row["value_deg"] for row in target if row.get("joint") == names[NU])
        return cls(
            q_max=np.radians(q_deg),
            qd_max=np.radians(per_joint(limits["qd_deg_s"], names)) * share,
            tau_lower=-tau - bound["lower_nm"],
            tau_upper=tau - bound["upper_nm"],
            input_weight=offline["input_weight"],
            t_f=(offline["t_f_min_s"], offline["t_f_max_s"]),
            max_iterations=offline["max_iterations"],
            intervals=offline["intervals"],
            pitch=np.radians(pitch),
            q8=np.radians(q8),
            grid=[{**axis, "joint": names.index(axis["joint"])} for axis in grid],
        )


@dataclass
class Result:
    """What IPOPT found."""

    solved: bool
    status: str
    cost: float
    t_f: float
    iterations: int
    attempts: int
    cpu_s: float


def cpu_seconds(who) -> float:
    usage = resource.getrusage(who)
    return usage.ru_utime + usage.ru_stime


class Peer:
    """The problem of every start, built and compiled once. Variables: t_F, then x_k and u_k of each knot."""

    def __init__(self, folder: Path, torque: str, cache: Path):
        self.chain = read_chain(folder / "robot.urdf")
        self.settings = s = Settings.read(folder, self.chain, torque)
        self.tau_centre, self.tau_half = (s.tau_lower + s.tau_upper) / 2, (s.tau_upper - s.tau_lower) / 2
        self._check_functions()
        self._knot_functions(torque)
        functions = self._problem_functions()
        library = compile_functions(functions, cache)
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
            "ipopt.max_iter": s.max_iterations,
        }
        self.solver = ca.nlpsol("swing_up", "ipopt", nlp, options)

    def _check_functions(self):
        """Functions to compare with `upswing model eval`, and the pendulum's equilibrium."""
        chain, n, n_a = self.chain, self.chain.n, self.chain.n_a
        q, qd, u, qdd = (ca.SX.sym(name, k) for name, k in (("q", n), ("qd", n), ("u", n_a), ("qdd", n)))
        zero = ca.SX.zeros(n)
        torque = inverse_dynamics(chain, q, zero, qdd)
        gravity = inverse_dynamics(chain, q, zero, zero)
        self.model = ca.Function(
            "model",
            [q, qd, u],
            [
                ca.jacobian(torque, qdd),
                inverse_dynamics(chain, q, qd, zero),
                gravity,
                ca.vertcat(qd, u, pendulum_acceleration(chain, q, qd, u)),
                motor_torque(chain, q, qd, u),
                motor_torque_without_coriolis(chain, q, u),
            ],
            ["q", "qd", "u"],
            ["M", "nle", "g", "f", "tau", "tau_without_coriolis"],
        )
        unactuated = gravity[n_a:]
        self._rest = ca.Function("rest", [q], [unactuated, ca.jacobian(unactuated, q[n_a:])])

    def rest(self, q_a) -> np.ndarray:
        """The state at rest with the pendulum hanging, g_U(q) = 0; Newton's method from the paper's q8 = q9 = 0,
        begun at the angle that is exact where joints 3, 5 and 7 are zero."""
        n, n_a = self.chain.n, self.chain.n_a
        q = np.concatenate([q_a, [0.0, q_a[1] - q_a[3] + q_a[5] - self.settings.pitch]])
        for _ in range(20):
            residual, jacobian = self._rest(q)
            q[n_a:] -= np.linalg.solve(jacobian.full(), residual.full().ravel())
        return np.concatenate([q, np.zeros(n)])

    def _knot_functions(self, torque):
        """f, scaled torque, and their derivatives at one knot."""
        chain, n, n_a, nx = self.chain, self.chain.n, self.chain.n_a, self.chain.nx
        N = self.settings.intervals
        x, u, t = ca.SX.sym("x", nx), ca.SX.sym("u", n_a), ca.SX.sym("t")
        q, qd, z = x[:n], x[n:], ca.vertcat(x, u)
        f = ca.vertcat(qd, u, pendulum_acceleration(chain, q, qd, u))
        tau = motor_torque(chain, q, qd, u) if torque == "exact" else motor_torque_without_coriolis(chain, q, u)
        tau = (tau - ca.DM(self.tau_centre)) / ca.DM(self.tau_half)
        cost = t + t / (2 * N) * self.settings.input_weight * ca.sumsqr(u)
        self.values = ca.Function("values", [x, u], [f, tau], {"cse": True})
        self.first = ca.Function("first", [x, u], [f, tau, ca.jacobian(f, z), ca.jacobian(tau, z)], {"cse": True})
        # Terms of the Lagrangian at a knot: w sums the multipliers of the defects on both sides.
        w, mu, sigma = ca.SX.sym("w", nx), ca.SX.sym("mu", n_a), ca.SX.sym("sigma")
        lagrangian = sigma * (cost - t) - t / (2 * N) * ca.dot(w, f) + ca.dot(mu, tau)
        hessian, gradient = ca.hessian(lagrangian, z)
        with_t = ca.densify(ca.jacobian(gradient, t))
        self.second = ca.Function(
            "second", [x, u, t, w, mu, sigma], [ca.triu(hessian), with_t], {"cse": True}
        )

    def _problem_functions(self):
        n_a, nx, nz = self.chain.n_a, self.chain.nx, self.chain.nz
        N, knots = self.settings.intervals, self.settings.intervals + 1
        v, p = ca.MX.sym("v", 1 + nz * knots), ca.MX.sym("p", 0)
        t, z = v[0], ca.reshape(v[1:], nz, knots)
        x, u = z[:nx, :], z[nx:, :]
        half_h, weight = t / (2 * N), self.settings.input_weight

        cost = t + half_h * weight * ca.sumsqr(u)
        f, tau = self.values.map(knots)(x, u)
        pitch = x[1, N] - x[3, N] + x[5, N]

        def constraints(f, tau):
            defects = x[:, 1:] - x[:, :-1] - half_h * (f[:, 1:] + f[:, :-1])
            return ca.vertcat(ca.vec(defects), ca.vec(tau), pitch)

        nlp = ca.Function("nlp", [v, p], [cost, constraints(f, tau)], ["x", "p"], ["f", "g"])

        gradient = ca.vec(ca.vertcat(ca.MX.zeros(nx, knots), 2 * half_h * weight * u))
        on_t = 1 + weight * ca.sumsqr(u) / (2 * N)
        grad_f = ca.Function(
            "nlp_grad_f", [v, p], [cost, ca.vertcat(on_t, gradient)], ["x", "p"], ["f", "grad_f_x"]
        )

        f, tau, f_z, tau_z = self.first.map(knots)(x, u)
        f_z, tau_z = ca.horzsplit(f_z, nz), ca.horzsplit(tau_z, nz)
        identity = ca.horzcat(ca.DM.eye(nx), ca.DM(nx, n_a))
        gap = ca.MX(nx * N, nz)
        defects = ca.horzcat(ca.diagcat(*(-identity - half_h * a for a in f_z[:-1])), gap) + ca.horzcat(
            gap, ca.diagcat(*(identity - half_h * a for a in f_z[1:]))
        )
        target = ca.DM(1, nz)
        target[0, 1], target[0, 3], target[0, 5] = 1, -1, 1
        jacobian = ca.vertcat(
            ca.horzcat(-ca.vec(f[:, 1:] + f[:, :-1]) / (2 * N), defects),
            ca.horzcat(ca.MX(n_a * knots, 1), ca.diagcat(*tau_z)),
            ca.horzcat(ca.MX(1, 1 + nz * N), target),
        )
        jac_g = ca.Function("nlp_jac_g", [v, p], [constraints(f, tau), jacobian], ["x", "p"], ["g", "jac_g_x"])

        sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", nx * N + n_a * knots + 1)
        multipliers = ca.reshape(lam[: nx * N], nx, N)
        none = ca.MX.zeros(nx, 1)
        w = ca.horzcat(multipliers, none) + ca.horzcat(none, multipliers)
        mu = ca.reshape(lam[nx * N : -1], n_a, knots)
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

    def straight_line(self, start: np.ndarray, t_f: float) -> np.ndarray:
        """From the start to the nearest state of (8), zero velocities and inputs."""
        n_a, nx = self.chain.n_a, self.chain.nx
        knots = self.settings.intervals + 1
        end = np.zeros(nx)
        coefficients = np.array([1.0, -1.0, 1.0])
        pose = start[[1, 3, 5]]
        end[[1, 3, 5]] = pose + coefficients * (self.settings.pitch - coefficients @ pose) / 3
        end[n_a] = self.settings.q8
        s = np.linspace(0, 1, knots)[:, None]
        return pack(t_f, start * (1 - s) + end * s, np.zeros((knots, n_a)))

    def bounds(self, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the variables. The start and all of the target but its pitch are fixed variables."""
        n_a, nx, nz = self.chain.n_a, self.chain.nx, self.chain.nz
        N, knots = self.settings.intervals, self.settings.intervals + 1
        s = self.settings
        upper = pack(s.t_f[1], np.tile(np.concatenate([s.q_max, s.qd_max]), (knots, 1)), np.full((knots, n_a), np.inf))
        lower = -upper
        lower[0] = s.t_f[0]
        end = np.zeros(nx)
        end[n_a] = s.q8
        free = [1, 3, 5]
        for bound in (lower, upper):
            bound[1 : 1 + nx] = start
            x_n = bound[1 + nz * N : 1 + nz * N + nx]
            kept = x_n[free].copy()
            x_n[:] = end
            x_n[free] = kept
        return lower, upper

    def solve(self, start: np.ndarray) -> Result:
        """Runs IPOPT; its CPU time alone is counted."""
        n_a, nx = self.chain.n_a, self.chain.nx
        N, knots = self.settings.intervals, self.settings.intervals + 1
        lower, upper = self.bounds(start)
        equal, torque = np.zeros(nx * N), np.ones(n_a * knots)
        lbg = np.concatenate([equal, -torque, [self.settings.pitch]])
        ubg = np.concatenate([equal, torque, [self.settings.pitch]])
        cpu, iterations = 0.0, 0
        for attempt, t_f in enumerate(GUESSES, 1):
            guess = self.straight_line(start, t_f)
            before = cpu_seconds(resource.RUSAGE_SELF)
            solution = self.solver(x0=guess, p=[], lbx=lower, ubx=upper, lbg=lbg, ubg=ubg)
            cpu += cpu_seconds(resource.RUSAGE_SELF) - before
            stats = self.solver.stats()
            iterations += stats["iter_count"]
            if stats["success"]:
                break
        return Result(
            solved=stats["success"],
            status=stats["return_status"],
            cost=float(solution["f"]),
            t_f=float(solution["x"][0]),
            iterations=iterations,
            attempts=attempt,
            cpu_s=cpu,
        )

    def audit(self, start: np.ndarray, t_f: float, x: np.ndarray, u: np.ndarray) -> dict[str, float]:
        """How far a trajectory (x: knots x nx, u: knots x n_a) is from meeting (6b), (6c), (8) and the torque
        constraint in this model, and its cost."""
        n, n_a = self.chain.n, self.chain.n_a
        N, knots = self.settings.intervals, self.settings.intervals + 1
        s = self.settings
        f, tau = (np.array(v).T for v in self.values.map(knots)(x.T, u.T))
        end = x[N].copy()
        target = [end[1] - end[3] + end[5] - s.pitch, *end[[0, 2, 4, 6]], end[n_a] - s.q8, end[n_a + 1], *end[n:]]

        def excess(values, limit):
            return float(np.maximum(np.abs(values) - limit, 0).max())

        return {
            "defect": float(np.abs(x[1:] - x[:-1] - t_f / (2 * N) * (f[1:] + f[:-1])).max()),
            "start": float(np.abs(x[0] - start).max()),
            "target": float(np.abs(target).max()),
            "position_rad": excess(x[:, :n], s.q_max),
            "velocity_rad_s": excess(x[:, n:], s.qd_max),
            "torque_nm": float((np.maximum(np.abs(tau) - 1, 0) * self.tau_half).max()),
            "t_f_s": max(s.t_f[0] - t_f, t_f - s.t_f[1], 0.0),
            "cost": t_f + t_f / (2 * N) * s.input_weight * float((u**2).sum()),
        }


def pack(t_f, x, u) -> np.ndarray:
    """The vector of variables."""
    return np.concatenate([[t_f], np.hstack([x, u]).ravel()])


def compile_functions(functions, cache: Path) -> Path:
    """Shared library of the functions; compiled only if the cache has none of the same source."""
    generator = ca.CodeGenerator("swing_up.c")
    for function in functions:
        generator.add(function)
    source = generator.dump()
    key = hashlib.sha256(" ".join([ca.__version__, *C_FLAGS, source]).encode()).hexdigest()[:16]
    library = cache / f"swing_up_{key}.so"
    if not library.exists():
        print("compiling the peer's functions ...", flush=True)
        cache.mkdir(parents=True, exist_ok=True)
        c_file = library.with_suffix(".c")
        c_file.write_text(source)
        unfinished = library.with_suffix(".tmp")
        subprocess.run(["gcc", *C_FLAGS, "-o", str(unfinished), str(c_file), "-lm"], check=True)
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
