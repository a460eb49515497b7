"""Measures what Python adds to the engine. Started by bench/python/run."""

import argparse
import contextlib
import glob
import os
import time
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import upswing
from upswing.gym import environment_id


def rate(call, seconds):
    """Calls per second: the median over ten slices of the time."""
    call()
    rates = []
    for _ in range(10):
        count, begin = 0, time.perf_counter()
        while (elapsed := time.perf_counter() - begin) < seconds / 10:
            call()
            count += 1
        rates.append(count / elapsed)
    return np.median(rates)


def calls(seconds):
    """Cost of one call of the model, and of one vector in a large batch on one core, which is the engine's own."""
    model = upswing.System.load("iiwa-pendulum").model
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, 18), rng.uniform(-1, 1, 7)
    # 63 vectors are computed on the thread of the caller.
    batch = 63
    xs, us = np.tile(x, (batch, 1)), np.tile(u, (batch, 1))
    q, qs = x[:9], xs[:, :9]
    print("| function of the arm | one call, us | one of a batch, us | of the call, us |")
    print("|---|---|---|---|")
    for name, one, many in [
        ("gravity", lambda: model.gravity(q), lambda: model.gravity(qs)),
        ("mass_matrix", lambda: model.mass_matrix(q), lambda: model.mass_matrix(qs)),
        ("f", lambda: model.f(x, u), lambda: model.f(xs, us)),
        ("torque", lambda: model.torque(x, u), lambda: model.torque(xs, us)),
        ("A", lambda: model.A(x, u), lambda: model.A(xs, us)),
    ]:
        single, part = 1e6 / rate(one, seconds), 1e6 / rate(many, seconds) / batch
        print(f"| `{name}` | {single:.2f} | {part:.2f} | {single - part:.2f} |")


def scheduled():
    """Times that each thread of this process has run, and has waited for a core that another program had, s."""
    times = {}
    for path in glob.glob("/proc/self/task/*/schedstat"):
        with contextlib.suppress(OSError):
            ran, waited, _ = map(int, Path(path).read_text().split())
            times[path] = np.array([ran, waited]) * 1e-9
    return times


def replans(count):
    """Replans one after the other, and in a batch."""
    system = upswing.System.load("iiwa-pendulum")
    planner = upswing.Planner(system)
    starts = upswing.random_starts(system, count)
    planner.replan_all(starts[:4])
    few = starts[: max(1, count // 10)]
    cpu = time.process_time()
    for start in few:
        planner.replan(start)
    alone = (time.process_time() - cpu) / len(few)
    before, wall = scheduled(), time.perf_counter()
    plans = planner.replan_all(starts)
    wall, after = time.perf_counter() - wall, scheduled()
    ran, waited = sum(times - before.get(thread, 0.0) for thread, times in after.items())
    found = sum(isinstance(plan, upswing.Plan) for plan in plans)
    print(
        f"\n{count} replans of the arm in a batch, {found} plans: {wall:.1f} s; threads ran {ran / wall:.2f} and waited for {waited / wall:.2f} of "
        f"{os.cpu_count()} cores; CPU time of a replan {1e3 * ran / count:.1f} ms, one after the other {1e3 * alone:.1f} ms"
    )


def mujoco_step(system, cycles):
    """A function that advances MuJoCo's simulation of the same URDF by so many periods of the plant, with the classical Runge-Kutta method."""
    spec = mujoco.MjSpec.from_string(system.urdf)
    # Its compiler refuses inertias that miss the triangle inequality, as identified ones do by rounding.
    spec.compiler.balanceinertia = True
    model = spec.compile()
    model.opt.gravity = 0, 0, -9.81
    model.opt.timestep = system.period
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    data.qpos[:] = system.start_state(system_middle(system))[: len(system.joints)]
    start = data.qpos.copy()
    hold = np.zeros(model.nv)

    def step():
        data.qfrc_applied[:] = hold
        mujoco.mj_step(model, data, nstep=cycles)
        if data.time > 0.5:
            mujoco.mj_resetData(model, data)
            data.qpos[:] = start

    return step


def system_middle(system):
    ranges = system.start_ranges()
    return [sum(ranges.get(joint, (0.0, 0.0))) / 2 for joint in system.actuated]


def steps(seconds):
    """Steps per second of environments, of the plant alone, and of MuJoCo."""
    print("\n| system | time of a step | plant | environment | of the plant's time | 64 side by side | MuJoCo |")
    print("|---|---|---|---|---|---|---|")
    for name in ("iiwa-pendulum", "cart-pole"):
        for dt in (0.000125, 0.01):
            dt = max(dt, upswing.System.load(name).period)
            env = gymnasium.make(environment_id(name), dt=dt).unwrapped
            task = env.task
            env.reset(seed=0)
            start = env.x
            action = np.zeros(env.action_space.shape, dtype=np.float32)
            plant = upswing.Plant(task.system, start)
            tau = np.zeros(len(task.system.actuated))
            count = 0

            def plain():
                nonlocal count
                plant.step(tau, task.cycles)
                count += 1
                if count * task.dt > 0.5:
                    plant.x, count = start, 0

            def stepped():
                if env.step(action)[2] or env._steps * task.dt > 0.5:
                    env.reset(options={"start": start})

            vector = gymnasium.make_vec(environment_id(name), num_envs=64, dt=dt)
            vector.reset(seed=0, options={"start": start})
            actions = np.zeros(vector.action_space.shape, dtype=np.float32)
            begun = 0

            def side_by_side():
                nonlocal begun
                vector.step(actions)
                begun += 1
                if begun * task.dt > 0.5:
                    vector.reset(options={"start": start})
                    begun = 0

            measured = {
                "plant": rate(plain, seconds),
                "environment": rate(stepped, seconds),
                "vector": 64 * rate(side_by_side, seconds),
                "mujoco": rate(mujoco_step(task.system, task.cycles), seconds),
            }
            print(
                f"| {name} | {1e3 * task.dt:g} ms, {task.cycles} periods | {measured['plant']:.0f} | {measured['environment']:.0f} | "
                f"{measured['plant'] / measured['environment']:.2f} | {measured['vector']:.0f} | {measured['mujoco']:.0f} |"
            )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=1.0, help="time of each measurement, s")
    parser.add_argument("--replans", type=int, default=1000, help="number of replans in the batch")
    arguments = parser.parse_args()
    calls(arguments.seconds)
    steps(arguments.seconds)
    replans(arguments.replans)


if __name__ == "__main__":
    main()
