"""Trains a policy that swings up and balances the cart-pole with Stable-Baselines3 (PyPI: stable-baselines3), and compares it with our planner
and with random actions.

    pip install "./python[gym]" stable-baselines3
    python python/examples/train_cart_pole.py [STEPS]

The policy learns with soft actor-critic (SAC) on one core.
"""

import sys

import gymnasium
import numpy as np
from upswing.gym import PlannerPolicy  # Registers the environments.

ENVIRONMENT = "upswing/CartPole-v0"
STEP = 0.02
"""Time of a step of the learned policy, s."""


def evaluate(env, choose, episodes=5):
    """In words, over episodes: the mean time in the target, that is the sum of the rewards times the time of a step, and how many end there."""
    totals, ended = [], 0
    for seed in range(1000, 1000 + episodes):
        observation, _ = env.reset(seed=seed)
        restart = getattr(choose, "reset", None)
        if restart:
            restart()
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(choose(observation))
            total += float(reward) * env.unwrapped.task.dt
            over = terminated or truncated
        totals.append(total)
        ended += truncated and reward > 0.9
    return f"{np.mean(totals):.2f} s of 10 s in the target, where {ended} of {episodes} episodes end"


def main():
    try:
        from stable_baselines3 import SAC
    except ImportError:
        print("skipped: stable-baselines3 is not installed")
        return
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    env = gymnasium.make(ENVIRONMENT, dt=STEP)
    env.action_space.seed(0)
    print(f"random actions: {evaluate(env, lambda _: env.action_space.sample())}")

    fine = gymnasium.make(ENVIRONMENT, action="acceleration", dt=0.002)
    policy = PlannerPolicy(fine)
    ours = lambda _: policy()  # noqa: E731
    ours.reset = policy.reset
    print(f"our planner and LQR: {evaluate(fine, ours)}")

    model = SAC("MlpPolicy", env, seed=0, device="cpu", gamma=0.99, learning_starts=1000, learning_rate=1e-3)
    model.learn(steps, progress_bar=False)
    learned = lambda observation: model.predict(observation, deterministic=True)[0]  # noqa: E731
    print(f"SAC after {steps} steps ({steps * STEP:.0f} s of simulated time): {evaluate(env, learned)}")


if __name__ == "__main__":
    main()
