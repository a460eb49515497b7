"""The problem (6), (8) for FATROP, an interior-point method for problems with stages, with exact derivatives compiled to C.

FATROP requires explicit dynamics. The trapezoidal rule x_k+1 - h/2 f_k+1 = x_k + h/2 f_k is explicit in p_k = x_k - h/2 f_k:

- state of stage k: p_k and t_F, which stays the same;
- input: u_k and the accelerations qdd_U,k, from which (and from p_k) x_k follows without solving anything;
- dynamics: p_k+1 = x_k + h/2 f_k;
- constraints: the equations of motion of the unactuated joints, torques, positions, velocities; start and target as equal bounds.

For the default robot these are 19 states; x_k, u_k, qdd_U,k and t_F as the state would be 28.
"""

import resource
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from model import accelerations, inverse_dynamics, motor_torque_without_coriolis
from peer import Peer, Solution, Start, compile_functions, cpu_seconds

C_FLAGS = ["-O3", "-march=native", "-fPIC", "-shared"]
OPTIONS = {"tolerance": 1e-8, "max_iter": 1000, "print_level": 0}
"""FATROP's own; the rest are its defaults."""


@dataclass
class Attempt:
    """FATROP's result from one guess."""

    solution: Solution | None
    iterations: int
    cpu_s: float


class Fatrop:
    """The problem of every start of a peer, built and compiled once."""

    def __init__(self, peer: Peer, torque: str, cache: Path, options: dict = OPTIONS):
        self.peer = peer
        chain, N = peer.chain, peer.limits.intervals
        self.ns, self.nw = chain.nx + 1, chain.n
        self._stage_functions(torque)
        library = compile_functions(self._problem_functions(), cache, C_FLAGS)
        knots = N + 1
        nlpsol_options = {
            "structure_detection": "manual",
            "N": N,
            "nx": [self.ns] * knots,
            "nu": [self.nw] * knots,
            "ng": [self.ng] * N + [self.ng + len(peer.sums)],
            "fatrop": options,
            "print_time": False,
        }
        self.solver = ca.nlpsol("manoeuvre", "fatrop", str(library), nlpsol_options)

    def _stage_functions(self, torque: str):
        """Next state, constraints and their derivatives at one stage."""
        peer, chain = self.peer, self.peer.chain
        n, n_a, N = chain.n, chain.n_a, peer.limits.intervals
        s, w = ca.SX.sym("s", self.ns), ca.SX.sym("w", self.nw)
        half_h = s[-1] / (2 * N)
        u, qdd_u = w[:n_a], w[n_a:]
        qdd = accelerations(chain, u, qdd_u)
        qd = s[n : 2 * n] + half_h * qdd
        q = s[:n] + half_h * qd
        tau = inverse_dynamics(chain, q, qd, qdd)
        motor = tau[chain.actuated] if torque == "exact" else motor_torque_without_coriolis(chain, q, u)
        scaled = (motor - ca.DM(peer.tau_centre)) / ca.DM(peer.tau_half)
        g = ca.vertcat(tau[chain.unactuated] / ca.DM(self._inertia()), scaled, q, qd)
        following = ca.vertcat(q + half_h * qd, qd + half_h * qdd, s[-1])
        z = ca.vertcat(s, w)
        self.ng = g.numel()
        rows = ca.vertcat(-following, g)
        self.states = ca.Function("states", [s, w], [q, qd])
        self.values = ca.Function("values", [s, w], [rows], {"cse": True})
        self.first = ca.Function("first", [s, w], [rows, ca.densify(ca.jacobian(rows, z))], {"cse": True})
        lam, sigma = ca.SX.sym("lam", rows.numel()), ca.SX.sym("sigma")
        cost = half_h * peer.limits.input_weight * ca.sumsqr(u)
        hessian, _ = ca.hessian(sigma * cost + ca.dot(lam, rows), z)
        self.second = ca.Function("second", [s, w, lam, sigma], [ca.densify(hessian)], {"cse": True})
        # Rows of the target with several joints, at the last knot.
        sums, lam = ca.DM(peer.manoeuvre.coefficients[peer.sums]) @ q, ca.SX.sym("lam", len(peer.sums))
        hessian, _ = ca.hessian(ca.dot(lam, sums), z)
        self.sums = ca.Function("sums", [s, w, lam], [sums, ca.densify(ca.jacobian(sums, z)), ca.densify(hessian)])

    def _inertia(self) -> np.ndarray:
        """Diagonal of M_UU where the joints are at 0: with it the equations of motion are accelerations."""
        zero = np.zeros(self.peer.chain.n)
        mass = self.peer.model(q=zero, qd=zero, u=np.zeros(self.peer.chain.n_a))["M"].full()
        return np.diag(mass)[self.peer.chain.unactuated]

    def _problem_functions(self):
        peer, ns, nw, ng = self.peer, self.ns, self.nw, self.ng
        chain, N = peer.chain, peer.limits.intervals
        knots, nz, n_a, weight = N + 1, ns + nw, chain.n_a, peer.limits.input_weight
        v, p = ca.MX.sym("v", nz * knots), ca.MX.sym("p", 0)
        z = ca.reshape(v, nz, knots)
        s, w = z[:ns, :], z[ns:, :]
        t, u = s[ns - 1, :], w[:n_a, :]
        rows, count = ns + ng, len(peer.sums)
        sigma, lam = ca.MX.sym("sigma"), ca.MX.sym("lam", rows * knots - ns + count)
        sums, sums_z, _ = self.sums(s[:, N], w[:, N], ca.MX.zeros(count))
        _, _, sums_zz = self.sums(s[:, N], w[:, N], lam[rows * knots - ns :])

        squares = ca.sum1(u**2)
        f = t[N] + weight / (2 * N) * ca.dot(t, squares)

        def constraints(values):
            inner = values[:, :N] + ca.vertcat(s[:, 1:], ca.MX(ng, N))
            return ca.vertcat(ca.vec(inner), values[ns:, N], sums)

        g = constraints(self.values.map(knots)(s, w))
        nlp = ca.Function("nlp", [v, p], [f, g], ["x", "p"], ["f", "g"])
        nlp_f = ca.Function("nlp_f", [v, p], [f], ["x", "p"], ["f"])
        nlp_g = ca.Function("nlp_g", [v, p], [g], ["x", "p"], ["g"])

        on_t = weight / (2 * N) * squares + ca.horzcat(ca.MX(1, N), 1)
        gradient = ca.vertcat(ca.MX(ns - 1, knots), on_t, weight / N * ca.repmat(t, n_a, 1) * u, ca.MX(nw - n_a, knots))
        grad_f = ca.Function("nlp_grad_f", [v, p], [ca.densify(ca.vec(gradient))], ["x", "p"], ["grad_f_x"])

        values, blocks = self.first.map(knots)(s, w)
        blocks = ca.horzsplit(blocks, nz)
        diagonal = ca.diagcat(*blocks[:N], ca.vertcat(blocks[N][ns:, :], sums_z))
        # p_k+1 and t_F of the next stage in the dynamics of this one.
        following = ca.diagcat(*[ca.vertcat(ca.horzcat(ca.DM.eye(ns), ca.DM(ns, nw)), ca.DM(ng, nz))] * N)
        following = ca.vertcat(ca.horzcat(ca.DM(rows * N, nz), following), ca.DM(ng + count, nz * knots))
        jac_g = ca.Function(
            "nlp_jac_g", [v, p], [constraints(values), diagonal + following], ["x", "p"], ["g", "jac_g_x"]
        )

        multipliers = ca.reshape(ca.vertcat(lam[: rows * N], ca.MX.zeros(ns), lam[rows * N : rows * knots - ns]), rows, knots)
        hessians = self.second.map(knots)(s, w, multipliers, ca.repmat(sigma, 1, knots))
        blocks = ca.horzsplit(hessians, nz)
        blocks[N] = blocks[N] + sums_zz
        hess_l = ca.Function(
            "nlp_hess_l",
            [v, p, sigma, lam],
            # FATROP does not read the gradient.
            [ca.MX(nz * knots, 1), ca.diagcat(*blocks)],
            ["x", "p", "lam_f", "lam_g"],
            ["grad_gamma_x", "hess_gamma_x_x"],
        )
        # CasADi takes cost and constraints at the solution from here; the gradients are for multipliers that nobody reads.
        unread = [ca.MX(nz * knots, 1), ca.MX(0, 1)]
        grad = ca.Function(
            "nlp_grad",
            [v, p, sigma, lam],
            [f, g, *unread],
            ["x", "p", "lam_f", "lam_g"],
            ["f", "g", "grad_gamma_x", "grad_gamma_p"],
        )
        return nlp, nlp_f, nlp_g, grad_f, jac_g, hess_l, grad

    def bounds(self, start: Start):
        """(lbx, ubx, lbg, ubg)"""
        peer, chain, limits = self.peer, self.peer.chain, self.peer.limits
        N, n, n_u = limits.intervals, chain.n, chain.n - chain.n_a
        free = np.full(self.ns + self.nw, np.inf)
        lbx, ubx = np.tile(-free, (N + 1, 1)), np.tile(free, (N + 1, 1))
        lbx[0, self.ns - 1], ubx[0, self.ns - 1] = limits.t_f
        gap, motion, torque = np.zeros(self.ns), np.zeros(n_u), np.ones(chain.n_a)
        lower = np.tile(np.concatenate([gap, motion, -torque, limits.q_min, -limits.qd_max]), (N + 1, 1))
        upper = np.tile(np.concatenate([gap, motion, torque, limits.q_max, limits.qd_max]), (N + 1, 1))
        for bound in (lower, upper):
            bound[0, -2 * n :] = start.x
            bound[N, -n:] = 0
            for i in peer.fixed:
                joint = int(np.flatnonzero(peer.manoeuvre.coefficients[i])[0])
                bound[N, joint - 2 * n] = start.rows[i] / peer.manoeuvre.coefficients[i, joint]
        sums = start.rows[peer.sums]
        lbg, ubg = (np.concatenate([b.ravel()[: b.size - b.shape[1]], b[N, self.ns :], sums]) for b in (lower, upper))
        return lbx.ravel(), ubx.ravel(), lbg, ubg

    def variables(self, guess: np.ndarray) -> np.ndarray:
        """The same states and inputs as the peer's variables `guess`."""
        chain, N = self.peer.chain, self.peer.limits.intervals
        t_f, z = guess[0], guess[1:].reshape(N + 1, chain.nz)
        x, u = z[:, : chain.nx], z[:, chain.nx :]
        f = self.peer.values.map(N + 1)(x.T, u.T)[0].full().T
        qdd_u = f[:, chain.n :][:, chain.unactuated]
        return np.hstack([x - t_f / (2 * N) * f, np.full((N + 1, 1), t_f), u, qdd_u]).ravel()

    def attempt(self, start: Start, guess: np.ndarray) -> Attempt:
        """Runs FATROP from a guess of the peer's; its CPU time alone is counted."""
        N = self.peer.limits.intervals
        x0 = self.variables(guess)
        lbx, ubx, lbg, ubg = self.bounds(start)
        before = cpu_seconds(resource.RUSAGE_SELF)
        result = self.solver(x0=x0, p=[], lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        cpu = cpu_seconds(resource.RUSAGE_SELF) - before
        stats = self.solver.stats()
        if not stats["success"]:
            return Attempt(None, stats["iter_count"], cpu)
        z = result["x"].full().reshape(N + 1, self.ns + self.nw)
        q, qd = (v.full().T for v in self.states.map(N + 1)(z[:, : self.ns].T, z[:, self.ns :].T))
        u = z[:, self.ns : self.ns + self.peer.chain.n_a]
        solution = Solution(float(result["f"]), float(z[0, self.ns - 1]), np.hstack([q, qd]).tolist(), u.tolist())
        return Attempt(solution, stats["iter_count"], cpu)
