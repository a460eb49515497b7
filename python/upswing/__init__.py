"""The engine of upswing: swing-up trajectories of underactuated arms, carts and cranes.

>>> import numpy as np, upswing
>>> system = upswing.System.load("iiwa-pendulum")
>>> planner = upswing.Planner(system)
>>> plan = planner.replan(np.deg2rad([-15, -15, 0, -95, 0, 10, 0]))
>>> run = upswing.ClosedLoop(planner, np.deg2rad([0, -15, 0, -95, 0, 10, 0])).run()
>>> run.success
True

Vectors of joints have the order of the chain, from base to tip, as `System.joints` names them: q and qd have n numbers, a state is
x = [q, qd] with 2n numbers. Inputs u and torques tau have one number for each of the n_A actuated joints, in the order of
`System.actuated`. Units are SI: rad, m, s, N m, N, kg. Functions of the model take arrays of any leading shape.
"""

from upswing._upswing import (
    ClosedLoop,
    Database,
    Model,
    Optimum,
    Plan,
    Planner,
    Plant,
    Plants,
    Run,
    System,
    Trajectory,
    build_database,
    lqr,
    monte_carlo,
    optimize,
    random_starts,
)
from upswing.errors import Aborted, InputError, NoPlan, UpswingError
from upswing.exports import export, export_plans
from upswing.recording import Recording, Report, report

__all__ = [
    "Aborted",
    "ClosedLoop",
    "Database",
    "InputError",
    "Model",
    "NoPlan",
    "Optimum",
    "Plan",
    "Planner",
    "Plant",
    "Plants",
    "Recording",
    "Report",
    "Run",
    "System",
    "Trajectory",
    "UpswingError",
    "build_database",
    "export",
    "export_plans",
    "lqr",
    "monte_carlo",
    "optimize",
    "random_starts",
    "report",
]
