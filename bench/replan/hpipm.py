"""HPIPM (https://github.com/giaf/hpipm) through its C interface, for the QPs of compare.py.

Stage j holds the state (s_{j-1}, dt) and the input du_j, where s_k is the state that leaves knot k and enters knot k+1 (ocp/src/kkt.rs),
so that the trapezoidal rule becomes s_j = A s_{j-1} + B du_j + along_j dt - r_j: the smallest form without inputs of two knots in one
stage. Stage 0 has dx_0 eliminated: its state is dt. Bounds of states and torques are general constraints on (s, u), that of dt a bound.
"""

import ctypes
from ctypes import byref, c_double, c_int, c_void_p
from importlib.util import find_spec
from pathlib import Path

import numpy as np

SPEED_ABS, SPEED, BALANCE, ROBUST = range(4)
TARGET_STIFFNESS = 1e8
"""Penalty of the orthonormal target rows: as constraints, which HPIPM has as two inequalities each, they make it fail."""


FOLDER = Path(find_spec("acados").submodule_search_locations[0]) / "install"


def library() -> ctypes.CDLL:
    ctypes.CDLL(str(FOLDER / "lib/libblasfeo.so"), mode=ctypes.RTLD_GLOBAL)
    hpipm = ctypes.CDLL(str(FOLDER / "lib/libhpipm.so"))
    for kind in ("dim", "", "sol", "ipm_arg", "ipm_ws"):
        for size in ("strsize", "memsize"):
            getattr(hpipm, "_".join(filter(None, ("d_ocp_qp", kind, size)))).restype = ctypes.c_size_t
    return hpipm


LIBRARY = library()


def target() -> str:
    """The instruction set that the library is built for, by the name of its headers."""
    return next(
        line.split()[1].removeprefix("TARGET_")
        for line in (FOLDER / "include/blasfeo/include/blasfeo_target.h").read_text().splitlines()
        if line.startswith("#define TARGET_") and "NEED" not in line
    )


def aligned(size: int) -> tuple[ctypes.Array, c_void_p]:
    """Memory, and an address in it that begins a cache line."""
    memory = ctypes.create_string_buffer(size + 64)
    return memory, c_void_p((ctypes.addressof(memory) + 63) // 64 * 64)


class Structure:
    """One of HPIPM's structures with its memory."""

    def __init__(self, kind: str, *arguments):
        name = "_".join(filter(None, ("d_ocp_qp", kind)))
        self._struct, self.address = aligned(getattr(LIBRARY, f"{name}_strsize")())
        self._memory, memory = aligned(getattr(LIBRARY, f"{name}_memsize")(*arguments))
        getattr(LIBRARY, f"{name}_create")(*arguments, self.address, memory)


def stages(p: "Problem") -> list[dict[str, np.ndarray]]:
    """`p` in HPIPM's form."""
    n, nx, nu = len(p.defects), p.nx, p.jacobian.shape[1]
    identity = np.eye(nx)
    out = []
    for k in range(n + 1):
        a, b = p.h / 2 * p.rate[k, :, :nx], p.h / 2 * p.rate[k, :, nx:]
        # z_k = along_x (s_{k-1}, dt) + along_u du_k + fixed.
        if k == 0:
            along_x, along_u = np.zeros((nx + nu, 1)), np.vstack([np.zeros((nx, nu)), np.eye(nu)])
            fixed = np.append(p.start, np.zeros(nu))
        else:
            enter = np.linalg.inv(identity - a)
            along_x = np.vstack([np.column_stack([enter, np.zeros(nx)]), np.zeros((nu, nx + 1))])
            along_u, fixed = np.vstack([enter @ b, np.eye(nu)]), np.zeros(nx + nu)
        weight, gradient = np.diag(p.weight[k]), p.weight[k] * fixed + p.gradient[k]
        if k == n:
            # Orthonormal rows: T' = rows' R.
            rows, r = np.linalg.qr(p.target[:, :nx].T)
            rows = np.hstack([rows.T, np.zeros((rows.shape[1], nu))])
            weight = weight + TARGET_STIFFNESS * rows.T @ rows
            gradient = gradient - TARGET_STIFFNESS * rows.T @ np.linalg.solve(r.T, p.target[:, nx])
        bounded, low, high = p.jacobian[k], *p.torque_bounds[k]
        if k > 0:
            bounded = np.vstack([np.eye(nx, nx + nu), bounded])
            low, high = np.append(p.bounds[k - 1, 0], low), np.append(p.bounds[k - 1, 1], high)
        stage = {
            "Q": along_x.T @ weight @ along_x,
            "S": along_u.T @ weight @ along_x,
            "R": along_u.T @ weight @ along_u,
            "q": along_x.T @ gradient,
            "r": along_u.T @ gradient,
            "C": bounded @ along_x,
            "D": bounded @ along_u,
            "lg": low - bounded @ fixed,
            "ug": high - bounded @ fixed,
        }
        if k == 0:
            stage["Q"], stage["q"] = np.array([[p.weight_t]]), np.array([p.gradient_t])
            stage["idxbx"], (stage["lbx"], stage["ubx"]) = [0], np.array(p.t_bounds)[:, None]
        if k < n:
            leave = np.hstack([identity + a, b])
            along_t = (p.f[k] + p.f[k + 1]) / (2 * n)
            to_next = np.vstack([leave @ along_x, np.zeros(along_x.shape[1])])
            to_next[:, -1] += np.append(along_t, 1.0)
            stage["A"], stage["B"] = to_next, np.vstack([leave @ along_u, np.zeros(nu)])
            stage["b"] = np.append(leave @ fixed - p.defects[k], 0.0)
        out.append(stage)
    return out


class Solver:
    """One QP in HPIPM's form and a solver for it."""

    def __init__(self, stages: list[dict[str, np.ndarray]], mode: int, settings: dict):
        """`stages`: matrices and vectors by HPIPM's names; `settings`: of `d_ocp_qp_ipm_arg_set_*`."""
        self.nx, self.nu = [len(s["q"]) for s in stages], [len(s["r"]) for s in stages]
        dim = Structure("dim", len(stages) - 1)
        for k, stage in enumerate(stages):
            numbers = {"nx": "q", "nu": "r", "nbx": "lbx", "ng": "lg"}
            for number, vector in numbers.items():
                getattr(LIBRARY, f"d_ocp_qp_dim_set_{number}")(k, len(stage.get(vector, ())), dim.address)
        self.dim, self.qp, self.solution = dim, Structure("", dim.address), Structure("sol", dim.address)
        self.argument = Structure("ipm_arg", dim.address)
        LIBRARY.d_ocp_qp_ipm_arg_set_default(mode, self.argument.address)
        for name, value in settings.items():
            value = c_int(value) if isinstance(value, int) else c_double(value)
            getattr(LIBRARY, f"d_ocp_qp_ipm_arg_set_{name}")(byref(value), self.argument.address)
        for k, stage in enumerate(stages):
            for name, value in stage.items():
                kind = c_int if name == "idxbx" else c_double
                column_major = np.asarray(value, dtype=kind).ravel(order="F")
                pointer = column_major.ctypes.data_as(ctypes.POINTER(kind))
                getattr(LIBRARY, f"d_ocp_qp_set_{name}")(k, pointer, self.qp.address)
        self.workspace = Structure("ipm_ws", dim.address, self.argument.address)

    def solve(self):
        LIBRARY.d_ocp_qp_ipm_solve(
            self.qp.address, self.solution.address, self.argument.address, self.workspace.address
        )

    def _integer(self, name: str) -> int:
        value = c_int()
        getattr(LIBRARY, f"d_ocp_qp_ipm_get_{name}")(self.workspace.address, byref(value))
        return value.value

    @property
    def solved(self) -> bool:
        return self._integer("status") == 0

    @property
    def iterations(self) -> int:
        return self._integer("iter")

    def z(self, p: "Problem") -> np.ndarray:
        """The steps of all knots."""
        z = np.zeros(p.weight.shape)
        for k, z_k in enumerate(z):
            u = self._vector("u", k, self.nu[k])
            z_k[p.nx :] = u
            if k == 0:
                z_k[: p.nx] = p.start
            else:
                s, rate = self._vector("x", k, self.nx[k])[: p.nx], p.h / 2 * p.rate[k]
                z_k[: p.nx] = np.linalg.solve(np.eye(p.nx) - rate[:, : p.nx], s + rate[:, p.nx :] @ u)
        return z

    def _vector(self, name: str, k: int, size: int) -> np.ndarray:
        out = np.zeros(size)
        pointer = out.ctypes.data_as(ctypes.POINTER(c_double))
        getattr(LIBRARY, f"d_ocp_qp_sol_get_{name}")(k, self.solution.address, pointer)
        return out
