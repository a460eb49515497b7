"""Trajectories as files for other tools."""

from __future__ import annotations

import json
import os
from typing import Any, Dict, Iterable, Optional, Union

import numpy as np

from upswing._upswing import Plan, Trajectory
from upswing.errors import InputError


def _document(trajectory: Trajectory, t: np.ndarray, x: np.ndarray, u: np.ndarray) -> Dict[str, Any]:
    q, qd = np.split(x, 2, axis=-1)
    names = {"joints": trajectory.joints, "actuated": trajectory.actuated, "t_f": trajectory.t_f}
    return {**names, "t": t.tolist(), "q": q.tolist(), "qd": qd.tolist(), "u": u.tolist()}


def export_plans(plans: Iterable[Union[Plan, Trajectory, None]], path: Union[str, "os.PathLike[str]"]) -> None:
    """Writes plans for `upswing montecarlo closed-loop --plans` and `upswing bench score --plans`: the i-th one for the i-th start, `None` for none.

    One JSON document per line, as `export` writes it; the command computes the gains. The file is replaced if it exists.
    """
    with open(path, "w", encoding="utf-8") as file:
        for plan in plans:
            trajectory = plan.trajectory if isinstance(plan, Plan) else plan
            document = trajectory and _document(trajectory, trajectory.t, trajectory.x, trajectory.u)
            file.write(json.dumps(document) + "\n")


def export(trajectory: Trajectory, path: Union[str, "os.PathLike[str]"], times: Optional[np.ndarray] = None) -> None:
    """Writes a trajectory to a file whose name ends in `.csv`, `.json` or `.npz`.

    One row for each of `times` (s); `None`: the knots. CSV has the columns `t`, `q_JOINT`, `qd_JOINT` for all joints and `u_JOINT`
    for the actuated ones; JSON and npz have `joints`, `actuated`, `t_f`, `t` (rows,), `q`, `qd` (rows, n), `u` (rows, n_A). Units
    are SI; numbers keep all digits. The file is replaced if it exists.

    Raises `InputError` for another ending.
    """
    t = trajectory.t if times is None else np.asarray(times, dtype=float)
    x = trajectory.x if times is None else trajectory.state(t)
    u = trajectory.u if times is None else trajectory.input(t)
    q, qd = np.split(x, 2, axis=-1)
    joints, actuated = trajectory.joints, trajectory.actuated
    ending = os.path.splitext(os.fspath(path))[1]
    if ending == ".csv":
        names = ["t", *(f"q_{j}" for j in joints), *(f"qd_{j}" for j in joints), *(f"u_{j}" for j in actuated)]
        rows = np.column_stack([t, q, qd, u]).tolist()
        with open(path, "w", encoding="utf-8") as file:
            file.writelines(",".join(map(str, row)) + "\n" for row in [names, *rows])
    elif ending == ".json":
        with open(path, "w", encoding="utf-8") as file:
            json.dump(_document(trajectory, t, x, u), file)
    elif ending == ".npz":
        with open(path, "wb") as file:
            np.savez(file, joints=joints, actuated=actuated, t_f=trajectory.t_f, t=t, q=q, qd=qd, u=u)
    else:
        raise InputError(f"{os.fspath(path)}: expected a name that ends in .csv, .json or .npz")
