"""Types of the compiled module. All of it is exported by `upswing`.

n joints from base to tip, n_A of them actuated. Arrays are of float64; `...` is any leading shape, a batch, the same for all arguments or none.
Units: rad and m for positions of joints that turn and slide, N m and N for their torques, s, kg.
"""

from os import PathLike
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, Union, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Benchmark",
    "ClosedLoop",
    "Database",
    "Model",
    "Optimum",
    "Plan",
    "Planner",
    "Plant",
    "Plants",
    "Run",
    "Score",
    "System",
    "Trajectory",
    "build_database",
    "lqr",
    "monte_carlo",
    "optimize",
    "random_starts",
    "realaigym",
    "read_recording",
    "report_html",
    "score_table",
]

_Array = NDArray[np.float64]
_Path = Union[str, "PathLike[str]"]
_Progress = Callable[[int, int], object]
_Controller = Callable[[float, _Array, _Array, _Array], ArrayLike]

@final
class Model:
    """The dynamics M(q) qdd + C(q, qd) qd + g(q) = tau of a system (1), in which the unactuated joints have no torque, and
    dx/dt = f(x, u) with the input u = qdd_A, the accelerations of the actuated joints (5)."""

    @property
    def joints(self) -> List[str]:
        """Names of the joints in the URDF, from base to tip."""
    @property
    def actuated(self) -> List[str]:
        """Names of the actuated joints, from base to tip."""
    @property
    def fingerprint(self) -> str:
        """Fingerprint of the dynamics, 16 hexadecimal digits: equal ones give equal numbers."""
    def mass_matrix(self, q: ArrayLike) -> _Array:
        """M(q), (..., n) to (..., n, n), kg m^2, kg m or kg."""
    def nonlinear_effects(self, q: ArrayLike, qd: ArrayLike) -> _Array:
        """C(q, qd) qd + g(q), (..., n), N m or N."""
    def gravity(self, q: ArrayLike) -> _Array:
        """g(q), (..., n), N m or N."""
    def inverse_dynamics(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> _Array:
        """M(q) qdd + C(q, qd) qd + g(q), (..., n), N m or N."""
    def forward_dynamics(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> _Array:
        """Accelerations of all joints under torques of all joints, (..., n) each."""
    def f(self, x: ArrayLike, u: ArrayLike) -> _Array:
        """dx/dt = f(x, u) (5): x (..., 2n), u (..., n_A), result (..., 2n)."""
    def A(self, x: ArrayLike, u: ArrayLike) -> _Array:
        """df/dx (19), exact: (..., 2n, 2n)."""
    def B(self, x: ArrayLike, u: ArrayLike) -> _Array:
        """df/du (19), exact: (..., 2n, n_A)."""
    def hessian(self, x: ArrayLike, u: ArrayLike, w: ArrayLike, mu: ArrayLike) -> _Array:
        """Second derivatives of w . qdd_U + mu . tau with respect to z = [q, qd, u], exact: w (n - n_A,) in the order of the unactuated joints,
        mu (n_A,), result (..., 2n + n_A, 2n + n_A), symmetric."""
    def torque(self, x: ArrayLike, u: ArrayLike, coriolis: bool = True) -> _Array:
        """Torque of the motors for the accelerations u, the torque law (9), (24): (..., n_A), N m or N. Without Coriolis terms as in (11)."""
    def forward_kinematics(self, q: ArrayLike) -> _Array:
        """Poses of the frames of the bodies in the world frame: homogeneous matrices, (..., n, 4, 4), m."""
    def tip(self, q: ArrayLike) -> _Array:
        """Tip of the pendulum in the world frame, (..., 3), m."""
    def energy(self, x: ArrayLike) -> _Array:
        """Kinetic and potential energy, (...,), J; the latter is 0 at the world's origin."""
    def rest_position(self, q_a: ArrayLike, upright: bool = False) -> _Array:
        """q with the actuated joints at q_a, (..., n_A), and the others hanging, or standing upright: (..., n).

        Raises `UpswingError` where there is no such equilibrium."""

@final
class System:
    """A robot with its settings and manoeuvres."""

    @staticmethod
    def load(system: Optional[_Path] = None) -> "System":
        """The shipped system of this name (`System.shipped()`), or the folder of a system; `None`: iiwa-pendulum.

        Raises `InputError` if it is unknown, or a file of it cannot be used."""
    @staticmethod
    def shipped() -> List[str]:
        """Names of the shipped systems."""
    @property
    def name(self) -> str:
        """Name of a shipped system, or its folder."""
    @property
    def model(self) -> Model:
        """The dynamics of planner and controller."""
    @property
    def joints(self) -> List[str]:
        """Names of the joints in the URDF, from base to tip: the order of q and qd."""
    @property
    def actuated(self) -> List[str]:
        """Names of the actuated joints: the order of u and tau."""
    @property
    def units(self) -> List[str]:
        """Units of the positions of the joints, "rad" or "m"."""
    @property
    def manoeuvres(self) -> List[str]:
        """Names of the manoeuvres; functions without a name take the first one."""
    @property
    def scenarios(self) -> List[str]:
        """Names of the plants that differ from the model, for `with_scenario`."""
    @property
    def period(self) -> float:
        """Control period, s."""
    @property
    def urdf(self) -> str:
        """Text of the robot description."""
    @property
    def limits(self) -> Dict[str, _Array]:
        """100 % limits: q_min, q_max, qd_max (n,), tau_max (n_A,)."""
    @property
    def planning_limits(self) -> Dict[str, _Array]:
        """Limits that plans keep, as `limits`."""
    def start_state(self, q_a: ArrayLike, manoeuvre: Optional[str] = None, *, pendulum: str = "rest") -> _Array:
        """State (2n,) at standstill in which a manoeuvre starts with the actuated joints at q_a (n_A,): the others hang at rest ("rest") or are at
        0 ("zero"); in a manoeuvre from standing they stand.

        Raises `InputError` outside the limits, or without an equilibrium."""
    def target(self, manoeuvre: Optional[str] = None, to: Optional[Mapping[str, float]] = None) -> Tuple[_Array, _Array]:
        """Rows C (m, 2n) and values d (m,) of the target C x = d of a manoeuvre (8)."""
    def start_ranges(self, manoeuvre: Optional[str] = None) -> Dict[str, Tuple[float, float]]:
        """Ranges of start positions of joints in the grid of a manoeuvre; the other actuated joints start at 0."""
    def target_ranges(self, manoeuvre: Optional[str] = None) -> Dict[str, Tuple[float, float]]:
        """Ranges of the positions that a manoeuvre asks for, by joint; empty if its target is fixed."""
    def with_scenario(self, scenario: str) -> "System":
        """The system with the plant of a scenario: a name, or the path of a .toml file. Planner and controller keep their model."""
    def files(self) -> Dict[str, bytes]:
        """Contents of the files of the system, settings in full, without databases: write them to a folder to make your own system."""

@final
class Trajectory:
    """A trajectory (7) of N + 1 knots, uniform in time, and its spline (12)."""

    def __new__(cls, system: System, t_f: float, x: ArrayLike, u: ArrayLike) -> "Trajectory":
        """A trajectory of arrays: t_f (s), x (N + 1, 2n), u (N + 1, n_A)."""
    @property
    def t_f(self) -> float:
        """Duration, s."""
    @property
    def t(self) -> _Array:
        """Times of the knots, (N + 1,), s."""
    @property
    def x(self) -> _Array:
        """States [q, qd], (N + 1, 2n)."""
    @property
    def u(self) -> _Array:
        """Accelerations of the actuated joints, (N + 1, n_A)."""
    @property
    def joints(self) -> List[str]:
        """Names of the joints: the order of the columns of x."""
    @property
    def actuated(self) -> List[str]:
        """Names of the actuated joints: the order of the columns of u."""
    @property
    def defect(self) -> float:
        """Largest defect of the dynamics (6b), rad or rad/s per interval."""
    @property
    def cost(self) -> float:
        """Cost (6a), s."""
    def state(self, t: ArrayLike) -> _Array:
        """x(t), (..., 2n), for times (...,) in s, which are clamped to the trajectory."""
    def input(self, t: ArrayLike) -> _Array:
        """u(t), (..., n_A)."""
    def margins(self, between: int = 0) -> Dict[str, float]:
        """Smallest margins to the limits of plans as shares of half the range, at the knots and `between` more points in each interval:
        margin_q, margin_qd, margin_tau; negative: violated."""
    def certificate(self) -> Dict[str, float]:
        """Cost, defect, margins (at ten points per interval) and end error of the real dynamics without feedback, as in a database."""
    def reversed(self) -> "Trajectory":
        """The trajectory in reversed time."""
    def __len__(self) -> int: ...

@final
class Optimum:
    """Result of `optimize`."""

    @property
    def trajectory(self) -> Trajectory:
        """The trajectory."""
    @property
    def status(self) -> str:
        """"solved", or why there is no solution."""
    @property
    def solved(self) -> bool:
        """Whether all residuals are within the tolerance."""
    @property
    def cost(self) -> float:
        """Cost (6a), s."""
    @property
    def iterations(self) -> int:
        """Number of iterations."""
    @property
    def violation(self) -> float:
        """Largest violation of a constraint."""
    @property
    def stationarity(self) -> float:
        """Largest scaled residual of the conditions of stationarity."""
    @property
    def multipliers(self) -> Dict[str, Any]:
        """Multipliers of L = J + sum lambda_k . c_k + nu . (C x_N - d) + sum zeta_k . x_k + sum pi_k . tau_k + zeta_t t_F, whose derivatives with
        respect to x_1..x_N, u_0..u_N and t_F are zero at an optimum; c_k = x_{k+1} - x_k - h/2 (f_k + f_{k+1}) are the defects (6b).

        A dictionary: "defects" lambda (N, 2n), s per unit of x; "target" nu (m,), rows as of `System.target`; "x" zeta (N + 1, 2n), that of the given
        x_0 is 0; "torque" pi (N + 1, n_A), s per N m or N, of the torque (9), or (11) if the settings say so; "t_f" zeta_t.
        Those of limits are positive at the upper limit and negative at the lower one. They are the last iterate's if there is no solution."""
    @property
    def margins(self) -> Dict[str, float]:
        """As `Trajectory.margins`."""

def optimize(
    system: System,
    start: ArrayLike,
    manoeuvre: Optional[str] = None,
    *,
    to: Optional[Mapping[str, float]] = None,
    best: bool = False,
    budget: Optional[float] = None,
    pendulum: str = "rest",
) -> Optimum:
    """Optimises a manoeuvre (6) from `start`, as `upswing optimize`: positions of the actuated joints (n_A,), at standstill, or a state (2n,).

    `to` gives positions of joints, by their names, to a manoeuvre that asks for some. `best` searches for the best of several local optima.
    `budget` limits each attempt, s. An unsolved optimum is no exception: see `Optimum.status`."""

@final
class Plan:
    """A trajectory with feedback gains: u = u_d + K (x - x_d)."""

    def __new__(
        cls, trajectory: Trajectory, gains: Optional[ArrayLike] = None, gain_end: Optional[ArrayLike] = None
    ) -> "Plan":
        """A plan of your own. Without gains (N + 1, n_A, 2n) and gain_end (n_A, 2n), those of `lqr`."""
    @property
    def trajectory(self) -> Trajectory:
        """The trajectory."""
    @property
    def gains(self) -> _Array:
        """K at the knots, (N + 1, n_A, 2n), 1/s^2 and 1/s."""
    @property
    def gain_end(self) -> _Array:
        """K that holds the end, (n_A, 2n)."""
    def desired(self, t: float) -> Tuple[_Array, _Array]:
        """x_d (2n,) and u_d (n_A,) at a time since the start, s; after the end x_N and 0."""
    def input(self, t: float, x: ArrayLike) -> _Array:
        """u = u_d + K (x - x_d), (n_A,)."""
    @property
    def t_f(self) -> float:
        """Duration, s."""
    @property
    def cost(self) -> float:
        """Cost (6a), s."""
    @property
    def defect(self) -> float:
        """Largest defect of the dynamics (6b), rad or rad/s per interval."""
    @property
    def status(self) -> str:
        """"solved", or "open defect" if the defect is above the setting."""
    @property
    def method(self) -> str:
        """"quadratic": adapted from an entry by QPs (16); "optimisation": optimised in full; "given": made from arrays."""
    @property
    def nearest_entry(self) -> Optional[int]:
        """Number of the database entry that was adapted, or is the nearest one."""
    @property
    def distance(self) -> Optional[float]:
        """Distance to that entry, rad."""
    @property
    def attempts(self) -> Optional[int]:
        """Number of entries tried."""
    @property
    def iterations(self) -> Optional[int]:
        """Number of QPs, or of iterations of the full optimisation."""
    @property
    def margins(self) -> Dict[str, float]:
        """As `Trajectory.margins`; of a replan also between the knots."""
    @property
    def times(self) -> Dict[str, float]:
        """Durations of the parts of the replan, s: nearest, qp, optimisation, check, lqr, total."""

def lqr(
    trajectory: Trajectory,
    *,
    q: Optional[ArrayLike] = None,
    q_end: Optional[ArrayLike] = None,
    r: Optional[float] = None,
) -> Tuple[_Array, _Array]:
    """Time-variant LQR (18)-(23): gains at the knots (N + 1, n_A, 2n), and the gain (n_A, 2n) that holds the end.

    Weights in place of those of the settings: diagonals q along the trajectory and q_end at its end (`None`: q), (2n,); r for all inputs.
    Raises `UpswingError` if no gain stabilises the end."""

@final
class Planner:
    """Plans from measured starts with the databases of a system."""

    def __new__(cls, system: System, *, manoeuvre: Optional[str] = None, database: Optional[_Path] = None) -> "Planner":
        """With the databases of the system, or with one file for one manoeuvre."""
    @property
    def system(self) -> System:
        """The system of the planner."""
    def entries(self, manoeuvre: Optional[str] = None) -> int:
        """Number of database entries of a manoeuvre."""
    def replan(
        self,
        start: ArrayLike,
        manoeuvre: Optional[str] = None,
        *,
        to: Optional[Mapping[str, float]] = None,
        iterations: Optional[int] = None,
        optimise: Optional[bool] = None,
        budget: Optional[float] = None,
        pendulum: str = "rest",
    ) -> Plan:
        """Plans from a start as `optimize` takes it: adapts the nearest entry, or optimises in full, as `upswing plan`.

        `iterations`: largest number of QPs per entry; 1 is the mode of the paper. `optimise`: whether the full optimisation may follow.
        `budget`: time, s. Raises `NoPlan` with the reasons."""
    def replan_all(
        self,
        starts: ArrayLike,
        manoeuvre: Optional[str] = None,
        *,
        to: Optional[Mapping[str, float]] = None,
        iterations: Optional[int] = None,
        optimise: Optional[bool] = None,
        pendulum: str = "rest",
        progress: Optional[_Progress] = None,
    ) -> List[Union[Plan, Exception]]:
        """Plans from each row of `starts` on all cores. A start without a plan has its `NoPlan` in the list."""
    def nearest(
        self,
        start: ArrayLike,
        manoeuvre: Optional[str] = None,
        *,
        to: Optional[Mapping[str, float]] = None,
        pendulum: str = "rest",
    ) -> List[Tuple[int, float]]:
        """Numbers and distances of the entries that `replan` tries, nearest first."""
    def database(self, manoeuvre: Optional[str] = None) -> Optional["Database"]:
        """The database of the system for a manoeuvre."""

@final
class Database:
    """A database of trajectories of one manoeuvre: a sequence of `Trajectory`."""

    @staticmethod
    def load(system: System, path: Optional[_Path] = None, manoeuvre: Optional[str] = None) -> "Database":
        """Reads a file, or the database of the system. Raises `InputError` if it is damaged, or of another robot or other settings."""
    @property
    def origin(self) -> str:
        """Path of the file, or name of the shipped database."""
    @property
    def manoeuvre(self) -> str:
        """Name of the manoeuvre."""
    @property
    def fingerprint(self) -> str:
        """Fingerprint of the contents, 16 hexadecimal digits."""
    @property
    def durations(self) -> _Array:
        """Durations of the entries, (entries,), s."""
    @property
    def keys(self) -> _Array:
        """Start poses q_A of the entries and the values given to their targets, (entries, n_A + given)."""
    def __len__(self) -> int: ...
    def __getitem__(self, number: int, /) -> Trajectory: ...
    def certificate(self, number: int) -> Dict[str, float]:
        """Certificate in the file, as `Trajectory.certificate` computes it."""
    def nearest(
        self, start: ArrayLike, count: int = 1, *, to: Optional[Mapping[str, float]] = None, pendulum: str = "rest"
    ) -> List[Tuple[int, float]]:
        """Numbers and distances of the nearest entries, nearest first."""
    def verify(self, progress: Optional[_Progress] = None) -> List[Tuple[int, str]]:
        """Recomputes all statements of the records, as `upswing db verify`: numbers of poses and their flaws; empty: none."""

def build_database(
    system: System,
    path: _Path,
    manoeuvre: Optional[str] = None,
    *,
    grid: Optional[_Path] = None,
    progress: Optional[_Progress] = None,
) -> Dict[str, Any]:
    """Builds the database of a manoeuvre into a file on all cores, as `upswing db build`, and returns the numbers of poses by outcome.

    `grid`: another grid of start poses, "paper" or a .toml file. `progress(done, total)` is called about every 0.1 s. After Ctrl-C or an
    exception of `progress` the finished lines stay in a journal, and the same call goes on from there."""

@final
class Plant:
    """The simulated robot with drives, encoders and friction, without a controller."""

    def __new__(cls, system: System, start: Optional[ArrayLike] = None) -> "Plant":
        """At a state (2n,), or with the actuated joints at (n_A,) and the others at rest; `None`: the start of the settings."""
    def step(self, tau: ArrayLike, cycles: int = 1) -> None:
        """Advances by control periods under constant torques (n_A,), which the drives cut to their limits."""
    def step_acceleration(self, u: ArrayLike, cycles: int = 1) -> None:
        """Advances under the torque law (24) for accelerations u (n_A,), computed in each period from the true state."""
    @property
    def x(self) -> _Array:
        """True state, (2n,). Setting it begins anew, with closed brakes."""
    @x.setter
    def x(self, x: ArrayLike) -> None: ...
    @property
    def t(self) -> float:
        """Simulated time, s."""
    @property
    def drive_fault(self) -> bool:
        """Whether the drives have failed, after a torque that is not finite."""
    def measure(self) -> Dict[str, Any]:
        """Measurement of the present cycle: seq, t (s), q (n,), tau (n_A,), status."""
    def push(self, impulse: Sequence[float], duration: float = 0.01, delay: float = 0.0) -> None:
        """Pushes the tip of the rod: impulse (3,), N s, world frame; duration and delay in s."""

@final
class Plants:
    """Plants of one system that advance side by side on all cores."""

    def __new__(cls, system: System, count: int) -> "Plants":
        """All at the start of the settings."""
    def put(self, number: int, x: ArrayLike) -> None:
        """Puts one plant at a state (2n,)."""
    def step(self, actions: ArrayLike, cycles: int = 1, acceleration: bool = False) -> _Array:
        """Advances all by control periods under torques, or accelerations, (count, n_A); returns the true states (count, 2n)."""
    @property
    def x(self) -> _Array:
        """True states, (count, 2n)."""
    @property
    def drive_faults(self) -> List[bool]:
        """Whether the drives of each plant have failed."""
    def __len__(self) -> int: ...

@final
class ClosedLoop:
    """Controller and plant in one process, bit for bit as the three processes on the clock `lockstep`."""

    def __new__(
        cls,
        planner: Planner,
        start: Optional[ArrayLike] = None,
        *,
        plant: Optional[System] = None,
        seed: int = 0,
    ) -> "ClosedLoop":
        """`start` as for `Plant`. `plant`: a system with another plant, as of `with_scenario`. `seed` of the encoders' noise."""
    def run(
        self,
        seconds: float = 4.0,
        *,
        plan: Optional[Plan] = None,
        controller: Optional[_Controller] = None,
        pushes: Sequence[Tuple[float, Sequence[float], float]] = ...,
    ) -> "Run":
        """Holds the arm, executes the first manoeuvre from the start, stays at its end for `seconds`, and evaluates the run.

        `plan`: your own instead of the planner's. `controller(t, x, x_d, u_d)`: your own, called in each cycle after the start of the plan
        with the time (s), the estimated state (2n,), and the reference; it returns the torques (n_A,), which are cut to the limits. Our
        controller estimates the velocities and monitors all limits meanwhile: a run that exceeds one ends, as ours would.
        `pushes`: (time after the start of the plan in s, impulse (3,) in N s, duration in s).
        Raises `Aborted` if the run cannot begin, and what the controller raises."""
    def enable(self) -> None:
        """Releases the brakes and holds the arm. Raises `UpswingError` with the reason of a refusal, as the other requests."""
    def hold(self) -> None:
        """Holds the present pose of the arm."""
    def start(self, plan: Plan) -> None:
        """Loads and starts a plan, after the checks of the daemon. Raises `UpswingError` if it is refused."""
    def stop(self) -> None:
        """Decelerates the arm, then holds it."""
    def reset(self) -> None:
        """Leaves Fault."""
    def advance(self, seconds: float) -> None:
        """Lets time pass, cycle by cycle."""
    @property
    def mode(self) -> str:
        """Mode of the controller: idle, hold, track, balance, stop or fault."""
    @property
    def trip(self) -> Optional[str]:
        """Why the controller left its mode, in words."""
    @property
    def t(self) -> float:
        """Simulated time, s."""
    @property
    def x(self) -> _Array:
        """State that the controller estimates, (2n,)."""
    @property
    def true_x(self) -> _Array:
        """State of the plant, (2n,)."""
    @property
    def records(self) -> Dict[str, Any]:
        """Cycles so far, fields as in a recording."""
    def push(self, impulse: Sequence[float], duration: float = 0.01, delay: float = 0.0) -> None:
        """Pushes the tip of the rod, as `Plant.push`."""
    def fault(self, kind: str, joint: Optional[str] = None, amount: float = 0.0, duration: float = 0.0) -> None:
        """Adds a fault of the plant, as `upswing disturb fault`; duration 0: until the end."""

@final
class Run:
    """A run in closed loop."""

    @property
    def success(self) -> bool:
        """Whether the system stayed at the end of the plan within all limits."""
    @property
    def aborted(self) -> Optional[str]:
        """Why the run ended early."""
    @property
    def failures(self) -> List[str]:
        """Criteria that were not met, as sentences."""
    @property
    def evaluation(self) -> Optional[Dict[str, Any]]:
        """Figures of the run, as `upswing demo --json` prints them; `None` if it ended early."""
    @property
    def records(self) -> Dict[str, Any]:
        """All cycles, fields as in a recording; `upswing.Recording.of(run)` wraps them."""
    def save(self, path: _Path) -> None:
        """Writes an MCAP recording, which Foxglove, PlotJuggler and `upswing report` read."""
    def _repr_html_page(self) -> str: ...
    def __len__(self) -> int: ...

def random_starts(system: System, samples: int, seed: int = 0) -> _Array:
    """Random start states (samples, 2n), those of `upswing montecarlo` with the same seed."""

def monte_carlo(
    planner: Planner,
    samples: int,
    *,
    seed: int = 0,
    condition: str = "nominal",
    seconds: float = 4.0,
    plans: Optional[Sequence[Optional[Plan]]] = None,
    threads: Optional[int] = None,
    progress: Optional[_Progress] = None,
) -> Dict[str, Any]:
    """Swings up from random starts on all cores, and balances for `seconds` (s), as `upswing montecarlo closed-loop`.

    `condition`: "nominal", "arm-mass", "pendulum-mass", "pendulum-length", a scenario of the system, or a .toml file. `progress(done, total)` is
    called about every 0.1 s. `plans`: one of your own for each start, or `None` for a run that has failed. The result is an element of `conditions` in the output of the command with --json: samples, succeeded, failures,
    spreads of the figures of the motion, and results of each start. All but its times depends on the settings, the seed and the condition only."""

def read_recording(path: _Path, start: float = 0.0, end: Optional[float] = None) -> Dict[str, Any]: ...
def report_html(path: _Path, start: float = 0.0, end: Optional[float] = None) -> str: ...

@final
class Benchmark:
    """Starts and conditions of runs of the first manoeuvre of a system, and the time at its end, as `upswing bench export` writes them."""

    def __new__(
        cls,
        system: System,
        samples: int = 20,
        *,
        seed: int = 0,
        conditions: Optional[Sequence[str]] = None,
        seconds: float = 4.0,
    ) -> "Benchmark":
        """The first starts of `upswing montecarlo` with this seed; `conditions` as of `monte_carlo`; success is judged in the last of the `seconds`."""
    @staticmethod
    def read(path: _Path) -> "Benchmark":
        """Reads a file of `export`. Raises `InputError` if it is none, or of another model or other settings."""
    def export(self, path: _Path) -> None:
        """Writes the benchmark as JSON with all digits, which `upswing bench score` reads. The file is replaced if it exists."""
    @property
    def system(self) -> System:
        """The system of planner and controller."""
    @property
    def starts(self) -> _Array:
        """Positions of the actuated joints at the starts, (samples, n_A), rad or m; the others hang at rest."""
    @property
    def conditions(self) -> List[str]:
        """Names of the conditions."""
    @property
    def seed(self) -> int:
        """Seed of starts and random conditions."""
    @property
    def seconds(self) -> float:
        """Time at the end of the plan, s."""
    def score(
        self,
        name: str,
        planner: Planner,
        *,
        plan: Optional[Callable[[_Array], Plan]] = None,
        controller: Optional[Callable[[Plan], _Controller]] = None,
        threads: Optional[int] = None,
        progress: Optional[_Progress] = None,
    ) -> "Score":
        """Runs every start under every condition.

        `plan(q_a)` gives the `Plan` for a start in place of `planner`'s, and `controller(plan)` a controller, as `ClosedLoop.run` takes it, in place
        of ours. An `UpswingError` of theirs is a run that has failed; other exceptions end the benchmark. `progress(done, total)` is called about
        every 0.1 s."""

@final
class Score:
    """The runs of one planner and controller in a benchmark."""

    @property
    def name(self) -> str:
        """Name of planner and controller."""
    @property
    def conditions(self) -> List[Dict[str, Any]]:
        """Results under each condition, as `upswing bench score --json` prints them: condition, samples, succeeded, failures, medians t_f and figures of the
        motion over the successful runs, results of each run."""
    def to_json(self) -> str:
        """All runs as JSON, the document of `upswing bench score --json`."""
    @staticmethod
    def of_json(text: str) -> "Score":
        """The score of such a document."""

def score_table(scores: Sequence[Score]) -> str:
    """A table of scores in Markdown, as `upswing bench score` prints it: success, and medians over the successful runs."""

def realaigym(
    system: System,
    score: str,
    controller: Optional[Callable[[], Callable[[float, _Array], Union[float, ArrayLike]]]] = None,
    *,
    seed: int = 0,
    progress: Optional[_Progress] = None,
) -> Dict[str, Any]:
    """Score of the RealAIGym leaderboards of the systems `acrobot` and `pendubot`, as `bench/realaigym/run` computes it, with its criteria.

    `score`: "performance" or "robustness" (version 2), "robustness-1" (version 1), "uptime" (version 3). `controller()` makes the controller of one
    simulation: a function of the time (s, counted in its calls) and the measured state [q1, q2, qd1, qd2] (4,), rad and rad/s, shoulder and elbow, which
    hang at 0, that is called every 2 ms and returns the torque of the motor, N m, which is cut to 6. `None`: ours, the daemon with one plan,
    which has no uptime. Robustness takes 720 simulations of 10 s: ours several minutes. `progress(done, total)` is called
    about every 0.1 s. The result has "score" and the criteria."""
