"""Gymnasium environments, one per shipped system: with this module imported, `gymnasium.make("upswing/IiwaPendulum-v0")`.

The first manoeuvre of the system, such as a swing-up, in simulation, with drives, encoders' friction and limits of the system.

Observation: float64, shape (n_A + 2 n_U + n,): positions of the actuated joints (rad or m), sine and cosine of the positions of the unactuated
joints (dimensionless), velocities of all joints from base to tip (rad/s or m/s). `info["x"]` is the state [q, qd] itself.

Action: float32 in [-1, 1], shape (n_A,): shares of the 100 % torques (`action="torque"`), or of accelerations (`action="acceleration"`),
which the torque law (24) turns into torques in every control period: those that these torques give to a joint at the start, or that reach
its 100 % velocity in 0.05 s, if they are smaller. It is held for `dt` (s).

Reward per step: `up (1 + near + slow) / 3 - 0.001 |action|^2` with `up`: the mean of (1 + cos e) / 2 over the unactuated joints, e (rad or m)
their distance from the target; `near`: exp(-|e_A|^2) of the other rows of the target (rad or m); `slow`: exp(-|qd_U|^2 / 10)
(rad/s or m/s). 1 at rest in the target.

Termination: a joint exceeds a 100 % limit of its position or velocity, or the drives fail; truncation after 10 s.

Start: the actuated joints uniform in the ranges of the manoeuvre's grid, the unactuated ones at rest; `options={"start": x}` of `reset`
gives another state.
"""

from __future__ import annotations

from typing import Any, Dict, List, Optional, Tuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from upswing._upswing import Model, Plan, Planner, Plants, System
from upswing.errors import InputError, UpswingError

__all__ = ["PlannerPolicy", "SystemEnv", "SystemVectorEnv", "Task", "environment_id"]

EPISODE = 10.0
"""Length of an episode, s."""
SPEEDING_UP = 0.05
"""Shortest time in which an acceleration takes a joint from rest to its velocity limit, s: the torque of a wrist could do so in a millisecond."""


def environment_id(system: str) -> str:
    """The id of the environment of a shipped system: `iiwa-pendulum` gives `upswing/IiwaPendulum-v0`."""
    return "upswing/" + "".join(part.capitalize() for part in system.split("-")) + "-v0"


for _system in System.shipped():
    gymnasium.register(
        environment_id(_system),
        entry_point="upswing.gym:SystemEnv",
        vector_entry_point="upswing.gym:SystemVectorEnv",
        kwargs={"system": _system},
    )


class Task:
    """The first manoeuvre of a system as a task: spaces, start, observation, reward and termination of states (..., 2n)."""

    def __init__(self, system: str | System, action: str, dt: float):
        if action not in ("torque", "acceleration"):
            raise InputError(f'`action`: expected "torque" or "acceleration", got {action!r}')
        self.system = system if isinstance(system, System) else System.load(system)
        self.model: Model = self.system.model
        self.acceleration = action == "acceleration"
        self.cycles = round(dt / self.system.period)
        if not 1 <= self.cycles <= 100_000:
            raise InputError(f"`dt`: expected {self.system.period} s or more, got {dt}")
        #: Time of a step, s: whole control periods.
        self.dt = self.cycles * self.system.period
        self.steps = round(EPISODE / self.dt)
        joints, actuated = self.system.joints, self.system.actuated
        self.n = len(joints)
        self.is_actuated = np.array([joint in actuated for joint in joints])
        self._ranges = self.system.start_ranges()
        # As the demonstration: to the last values of the database where the manoeuvre asks for some.
        to = {joint: last for joint, (_, last) in self.system.target_ranges().items()}
        rows, values = self.system.target(to=to)
        # The rows of the velocities, which are to be 0, are left to `slow`.
        position = np.abs(rows[:, : self.n]).sum(axis=1) > 0
        self._rows, self._values = rows[position, : self.n], values[position]
        self._up = np.abs(self._rows[:, ~self.is_actuated]).sum(axis=1) > 0
        limits = self.system.limits
        # Plans may use a wider range of some unactuated joints than their encoders' 100 %: a rod that stands at 180 deg needs both sides.
        plans = self.system.planning_limits
        self._q_min = np.where(self.is_actuated, limits["q_min"], np.minimum(limits["q_min"], plans["q_min"]))
        self._q_max = np.where(self.is_actuated, limits["q_max"], np.maximum(limits["q_max"], plans["q_max"]))
        self._qd_max = limits["qd_max"]
        #: What an action of 1 means, N m and N or rad/s^2 and m/s^2, shape (n_A,).
        fastest = limits["qd_max"][self.is_actuated] / SPEEDING_UP
        tau_max = limits["tau_max"]
        self.scale = np.minimum(self._accelerations(tau_max), fastest) if self.acceleration else tau_max
        width = len(actuated) + 2 * (self.n - len(actuated)) + self.n
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (width,), np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(actuated),), np.float32)

    def _accelerations(self, tau_max: np.ndarray) -> np.ndarray:
        """Accelerations of the actuated joints, one after the other, under the largest torques at the start."""
        x = self.system.start_state(self._middle())
        none = np.zeros(len(tau_max))
        unit = self.model.torque(x, np.eye(len(tau_max))) - self.model.torque(x, none)
        return tau_max / np.diag(unit)

    def _middle(self) -> np.ndarray:
        middle = [sum(self._ranges.get(joint, (0.0, 0.0))) / 2 for joint in self.system.actuated]
        return np.array(middle)

    def start(self, rng: np.random.Generator) -> np.ndarray:
        """A random start state."""
        for _ in range(1000):
            ranges = [self._ranges.get(joint, (0.0, 0.0)) for joint in self.system.actuated]
            try:
                return self.system.start_state([rng.uniform(*ends) for ends in ranges])
            except InputError:
                # In some poses of an arm the pendulum cannot hang within its limits.
                continue
        raise UpswingError("the ranges of the grid hold no start in which the unactuated joints hang within their limits")

    def observation(self, x: np.ndarray) -> np.ndarray:
        q = x[..., : self.n]
        free = q[..., ~self.is_actuated]
        return np.concatenate([q[..., self.is_actuated], np.sin(free), np.cos(free), x[..., self.n :]], axis=-1)

    def reward(self, x: np.ndarray, action: np.ndarray) -> np.ndarray:
        away = x[..., : self.n] @ self._rows.T - self._values
        up = np.mean(0.5 + 0.5 * np.cos(away[..., self._up]), axis=-1)
        near = np.exp(-np.sum(away[..., ~self._up] ** 2, axis=-1))
        slow = np.exp(-0.1 * np.sum(x[..., self.n :][..., ~self.is_actuated] ** 2, axis=-1))
        effort = 0.001 * np.sum(np.square(action, dtype=np.float64), axis=-1)
        return up * (1 + near + slow) / 3 - effort

    def is_over(self, x: np.ndarray, failed: np.ndarray | bool) -> np.ndarray:
        q, qd = x[..., : self.n], x[..., self.n :]
        outside = (q < self._q_min) | (q > self._q_max) | (np.abs(qd) > self._qd_max)
        return outside.any(axis=-1) | failed


class SystemVectorEnv(gymnasium.vector.VectorEnv):
    """Copies of the environment that advance side by side on all cores."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}

    def __init__(
        self, num_envs: int = 1, *, system: str | System = "iiwa-pendulum", action: str = "torque", dt: float = 0.01
    ):
        self.task = Task(system, action, dt)
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = self.task.observation_space, self.task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._plants = Plants(self.task.system, num_envs)
        self._steps = np.zeros(num_envs, dtype=int)
        self._ended = np.zeros(num_envs, dtype=bool)
        self._rngs: List[np.random.Generator] = [np.random.default_rng() for _ in range(num_envs)]

    def _restart(self, number: int, start: Optional[np.ndarray] = None) -> None:
        self._plants.put(number, self.task.start(self._rngs[number]) if start is None else start)
        self._steps[number] = 0

    def _info(self, x: np.ndarray) -> Dict[str, Any]:
        return {"x": x, "_x": np.ones(self.num_envs, dtype=bool)}

    def reset(
        self, *, seed: Optional[int | List[Optional[int]]] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        if seed is not None:
            seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed
            self._rngs = [np.random.default_rng(one) for one in seeds]
        starts = (options or {}).get("start")
        mask = (options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool))
        for i in np.flatnonzero(mask).tolist():
            self._restart(i, None if starts is None else np.broadcast_to(starts, (self.num_envs, 2 * self.task.n))[i])
            self._ended[i] = False
        x = self._plants.x
        return self.task.observation(x), self._info(x)

    def step(
        self, actions: np.ndarray
    ) -> Tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Dict[str, Any]]:
        task, restarted = self.task, self._ended
        actions = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        x = self._plants.step(actions * task.scale, task.cycles, task.acceleration)
        self._steps += 1
        if restarted.any():
            for i in np.flatnonzero(restarted).tolist():
                self._restart(i)
            x = self._plants.x
        reward = np.where(restarted, 0.0, task.reward(x, actions))
        terminated = task.is_over(x, np.asarray(self._plants.drive_faults)) & ~restarted
        truncated = (self._steps >= task.steps) & ~terminated
        self._ended = terminated | truncated
        return task.observation(x), reward, terminated, truncated, self._info(x)


class SystemEnv(gymnasium.Env):
    """The environment of a system: see the module."""

    metadata = {"render_modes": []}

    def __init__(self, system: str | System = "iiwa-pendulum", action: str = "torque", dt: float = 0.01):
        self.task = Task(system, action, dt)
        self.observation_space, self.action_space = self.task.observation_space, self.task.action_space
        self._plants = Plants(self.task.system, 1)
        self._steps = 0

    @property
    def x(self) -> np.ndarray:
        """The state [q, qd], (2n,)."""
        return self._plants.x[0]

    def reset(
        self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Dict[str, Any]]:
        super().reset(seed=seed)
        start = (options or {}).get("start")
        self._plants.put(0, self.task.start(self.np_random) if start is None else start)
        self._steps = 0
        return self.task.observation(self.x), {"x": self.x}

    def step(self, action: np.ndarray) -> Tuple[np.ndarray, float, bool, bool, Dict[str, Any]]:
        task = self.task
        action = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        x = self._plants.step((action * task.scale)[None], task.cycles, task.acceleration)[0]
        self._steps += 1
        terminated = bool(task.is_over(x, self._plants.drive_faults[0]))
        truncated = self._steps >= task.steps and not terminated
        return task.observation(x), float(task.reward(x, action)), terminated, truncated, {"x": x}


class PlannerPolicy:
    """The baseline: our plan from the state of the reset, followed with its LQR gains."""

    def __init__(self, env: gymnasium.Env, planner: Optional[Planner] = None):
        self._env: SystemEnv = env.unwrapped  # type: ignore[assignment]
        task = self._env.task
        self._planner = Planner(task.system) if planner is None else planner
        self._to = {joint: last for joint, (_, last) in task.system.target_ranges().items()}
        self._plan: Optional[Plan] = None

    def reset(self) -> None:
        """Plans from the present state. Raises `NoPlan`."""
        self._plan = self._planner.replan(self._env.x, to=self._to)
        self._t = 0.0

    def __call__(self) -> np.ndarray:
        """The action for the present state."""
        if self._plan is None:
            self.reset()
        assert self._plan is not None
        task, x = self._env.task, self._env.x
        u = self._plan.input(self._t, x)
        self._t += task.dt
        action = u if task.acceleration else task.model.torque(x, u)
        return np.clip(action / task.scale, -1.0, 1.0).astype(np.float32)
