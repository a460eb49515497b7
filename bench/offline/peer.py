"""The problem (6), (8) with the torque constraint (9) or (11) for IPOPT, with exact derivatives compiled to C.

Derivatives are built knot by knot (a dense Hessian of 25 variables each), which is faster to evaluate than what
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

from model import NQ, NU, NX, NZ, inverse_dynamics, motor_torque, motor_torque_without_coriolis
from model import pendulum_acceleration, read_chain

N = 100
KNOTS = N + 1
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
    pitch: float
    q8: float
    grid: list[dict]

    @classmethod
    def read(cls, folder: Path, torque: str):
        robot = tomllib.loads((folder / "robot.toml").read_text())
        planner = tomllib.loads((folder / "planner.toml").read_text())
        limits, usage, offline = robot["limits"], robot["usage"], planner["offline"]
        names = [joint.name for joint in read_chain(folder / "robot.urdf")]
        q_deg = per_joint(limits["q_deg"], names)
        if (q_deg[:, 0] != -q_deg[:, 1]).any():
            raise ValueError("limits.q_deg of robot.toml: expected ranges that are symmetric about 0")
        q_deg = q_deg[:, 1]
        q_deg[NU:] += per_joint(usage["position_margin_deg"], names[NU:])
        share = [usage["velocity_fraction_actuated"]] * NU + [usage["velocity_fraction_unactuated"]] * (NQ - NU)
        tau = per_joint(limits["tau_nm"], names[:NU]) * usage["torque_fraction"]
        bound = {
            key: per_joint(v, names[:NU]) if torque == "paper" else 0.0 for key, v in robot["coriolis_bound"].items()
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
        self.settings = s = Settings.read(folder, torque)
        chain = read_chain(folder / "robot.urdf")
        self.tau_centre, self.tau_half = (s.tau_lower + s.tau_upper) / 2, (s.tau_upper - s.tau_lower) / 2
        self._check_functions(chain)
        self._knot_functions(chain, torque)
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

    def _check_functions(self, chain):
        """Functions to compare with `upswing model eval`, and the pendulum's equilibrium."""
        q, qd, u, qdd = (ca.SX.sym(n, k) for n, k in (("q", NQ), ("qd", NQ), ("u", NU), ("qdd", NQ)))
        zero = ca.SX.zeros(NQ)
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
        unactuated = gravity[NU:]
        self._rest = ca.Function("rest", [q], [unactuated, ca.jacobian(unactuated, q[NU:])])

    def rest(self, q_a) -> np.ndarray:
        """The state at rest with the pendulum hanging, g_U(q) = 0; Newton's method from the paper's q8 = q9 = 0,
        begun at the angle that is exact where joints 3, 5 and 7 are zero."""
        q = np.concatenate([q_a, [0.0, q_a[1] - q_a[3] + q_a[5] - self.settings.pitch]])
        for _ in range(20):
            residual, jacobian = self._rest(q)
            q[NU:] -= np.linalg.solve(jacobian.full(), residual.full().ravel())
        return np.concatenate([q, np.zeros(NQ)])

    def _knot_functions(self, chain, torque):
        """f, scaled torque, and their derivatives at one knot."""
        x, u, t = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("t")
        q, qd, z = x[:NQ], x[NQ:], ca.vertcat(x, u)
        f = ca.vertcat(qd, u, pendulum_acceleration(chain, q, qd, u))
        tau = motor_torque(chain, q, qd, u) if torque == "exact" else motor_torque_without_coriolis(chain, q, u)
        tau = (tau - ca.DM(self.tau_centre)) / ca.DM(self.tau_half)
        cost = t + t / (2 * N) * self.settings.input_weight * ca.sumsqr(u)
        self.values = ca.Function("values", [x, u], [f, tau], {"cse": True})
        self.first = ca.Function("first", [x, u], [f, tau, ca.jacobian(f, z), ca.jacobian(tau, z)], {"cse": True})
        # Terms of the Lagrangian at a knot: w sums the multipliers of the defects on both sides.
        w, mu, sigma = ca.SX.sym("w", NX), ca.SX.sym("mu", NU), ca.SX.sym("sigma")
        lagrangian = sigma * (cost - t) - t / (2 * N) * ca.dot(w, f) + ca.dot(mu, tau)
        hessian, gradient = ca.hessian(lagrangian, z)
        with_t = ca.densify(ca.jacobian(gradient, t))
        self.second = ca.Function(
            "second", [x, u, t, w, mu, sigma], [ca.triu(hessian), with_t], {"cse": True}
        )

    def _problem_functions(self):
        v, p = ca.MX.sym("v", 1 + NZ * KNOTS), ca.MX.sym("p", 0)
        t, z = v[0], ca.reshape(v[1:], NZ, KNOTS)
        x, u = z[:NX, :], z[NX:, :]
        half_h, weight = t / (2 * N), self.settings.input_weight

        cost = t + half_h * weight * ca.sumsqr(u)
        f, tau = self.values.map(KNOTS)(x, u)
        pitch = x[1, N] - x[3, N] + x[5, N]

        def constraints(f, tau):
            defects = x[:, 1:] - x[:, :-1] - half_h * (f[:, 1:] + f[:, :-1])
            return ca.vertcat(ca.vec(defects), ca.vec(tau), pitch)

        nlp = ca.Function("nlp", [v, p], [cost, constraints(f, tau)], ["x", "p"], ["f", "g"])

        gradient = ca.vec(ca.vertcat(ca.MX.zeros(NX, KNOTS), 2 * half_h * weight * u))
        on_t = 1 + weight * ca.sumsqr(u) / (2 * N)
        grad_f = ca.Function(
            "nlp_grad_f", [v, p], [cost, ca.vertcat(on_t, gradient)], ["x", "p"], ["f", "grad_f_x"]
        )

        f, tau, f_z, tau_z = self.first.map(KNOTS)(x, u)
        f_z, tau_z = ca.horzsplit(f_z, NZ), ca.horzsplit(tau_z, NZ)
        identity = ca.horzcat(ca.DM.eye(NX), ca.DM(NX, NU))
        gap = ca.MX(NX * N, NZ)
        defects = ca.horzcat(ca.diagcat(*(-identity - half_h * a for a in f_z[:-1])), gap) + ca.horzcat(
            gap, ca.diagcat(*(identity - half_h * a for a in f_z[1:]))
        )
        target = ca.DM(1, NZ)
        target[0, 1], target[0, 3], target[0, 5] = 1, -1, 1
        jacobian = ca.vertcat(
            ca.horzcat(-ca.vec(f[:, 1:] + f[:, :-1]) / (2 * N), defects),
            ca.horzcat(ca.MX(NU * KNOTS, 1), ca.diagcat(*tau_z)),
            ca.horzcat(ca.MX(1, 1 + NZ * N), target),
        )
        jac_g = ca.Function("nlp_jac_g", [v, p], [constraints(f, tau), jacobian], ["x", "p"], ["g", "jac_g_x"])

        sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", NX * N + NU * KNOTS + 1)
        multipliers = ca.reshape(lam[: NX * N], NX, N)
        none = ca.MX.zeros(NX, 1)
        w = ca.horzcat(multipliers, none) + ca.horzcat(none, multipliers)
        mu = ca.reshape(lam[NX * N : -1], NU, KNOTS)
        scalars = [ca.repmat(scalar, 1, KNOTS) for scalar in (t, sigma)]
        blocks, with_t = self.second.map(KNOTS)(x, u, scalars[0], w, mu, scalars[1])
        hessian = ca.vertcat(
            ca.horzcat(ca.MX(1, 1), ca.vec(with_t).T),
            ca.horzcat(ca.MX(NZ * KNOTS, 1), ca.diagcat(*ca.horzsplit(blocks, NZ))),
        )
        hess_lag = ca.Function(
            "nlp_hess_l", [v, p, sigma, lam], [hessian], ["x", "p", "lam_f", "lam_g"], ["triu_hess_gamma_x_x"]
        )
        return nlp, grad_f, jac_g, hess_lag

    def straight_line(self, start: np.ndarray, t_f: float) -> np.ndarray:
        """From the start to the nearest state of (8), zero velocities and inputs."""
        end = np.zeros(NX)
        coefficients = np.array([1.0, -1.0, 1.0])
        pose = start[[1, 3, 5]]
        end[[1, 3, 5]] = pose + coefficients * (self.settings.pitch - coefficients @ pose) / 3
        end[NU] = self.settings.q8
        s = np.linspace(0, 1, KNOTS)[:, None]
        return pack(t_f, start * (1 - s) + end * s, np.zeros((KNOTS, NU)))

    def bounds(self, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the variables. The start and all of the target but its pitch are fixed variables."""
        s = self.settings
        upper = pack(s.t_f[1], np.tile(np.concatenate([s.q_max, s.qd_max]), (KNOTS, 1)), np.full((KNOTS, NU), np.inf))
        lower = -upper
        lower[0] = s.t_f[0]
        end = np.zeros(NX)
        end[NU] = s.q8
        free = [1, 3, 5]
        for bound in (lower, upper):
            bound[1 : 1 + NX] = start
            x_n = bound[1 + NZ * N : 1 + NZ * N + NX]
            kept = x_n[free].copy()
            x_n[:] = end
            x_n[free] = kept
        return lower, upper

    def solve(self, start: np.ndarray) -> Result:
        """Runs IPOPT; its CPU time alone is counted."""
        lower, upper = self.bounds(start)
        equal, torque = np.zeros(NX * N), np.ones(NU * KNOTS)
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
        """How far a trajectory (x: KNOTS x NX, u: KNOTS x NU) is from meeting (6b), (6c), (8) and the torque
        constraint in this model, and its cost."""
        s = self.settings
        f, tau = (np.array(v).T for v in self.values.map(KNOTS)(x.T, u.T))
        end = x[N].copy()
        target = [end[1] - end[3] + end[5] - s.pitch, *end[[0, 2, 4, 6]], end[NU] - s.q8, end[NU + 1], *end[NQ:]]

        def excess(values, limit):
            return float(np.maximum(np.abs(values) - limit, 0).max())

        return {
            "defect": float(np.abs(x[1:] - x[:-1] - t_f / (2 * N) * (f[1:] + f[:-1])).max()),
            "start": float(np.abs(x[0] - start).max()),
            "target": float(np.abs(target).max()),
            "position_rad": excess(x[:, :NQ], s.q_max),
            "velocity_rad_s": excess(x[:, NQ:], s.qd_max),
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
