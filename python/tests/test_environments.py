"""The Gymnasium environments."""

import numpy as np
import pytest
import upswing

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402
from upswing.gym import PlannerPolicy, environment_id  # noqa: E402

SYSTEMS = upswing.System.shipped()


@pytest.mark.parametrize("action", ["torque", "acceleration"])
@pytest.mark.parametrize("system", SYSTEMS)
# Positions beyond a limit end an episode and are observed, velocities have no bound.
@pytest.mark.filterwarnings("error", "ignore:.*A Box observation space m..imum value is -?infinity")
def test_the_checker_of_gymnasium_passes(system, action):
    env = gymnasium.make(environment_id(system), action=action)
    check_env(env.unwrapped, skip_render_check=True)


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_seed_gives_the_same_bits_alone_and_side_by_side(system):
    env = gymnasium.make(environment_id(system))
    vector = gymnasium.make_vec(environment_id(system), num_envs=3)
    observations, _ = vector.reset(seed=[7, 8, 9])
    actions = [vector.action_space.sample() for _ in range(20)]
    seen = [observations, *(vector.step(action)[0] for action in actions)]
    observation, info = env.reset(seed=8)
    assert np.array_equal(observation, seen[0][1])
    for action, expected in zip(actions, seen[1:]):
        observation, reward, terminated, _, info = env.step(action[1])
        assert np.array_equal(observation, expected[1])
        if terminated:
            break


def test_ended_environments_start_anew():
    vector = gymnasium.make_vec(environment_id("cart-pole"), num_envs=4)
    vector.reset(seed=1)
    ended = np.zeros(4, dtype=bool)
    for _ in range(200):
        _, reward, terminated, truncated, info = vector.step(np.ones((4, 1), dtype=np.float32))
        assert not (ended & (terminated | truncated)).any()
        assert np.all(reward[ended] == 0.0)
        ended = terminated | truncated
        if ended.all():
            break
    assert ended.all()
    _, reward, _, _, info = vector.step(np.zeros((4, 1), dtype=np.float32))
    assert np.abs(info["x"][:, 0]).max() <= 0.2


def play(env, policy, seed):
    """Sum of the rewards of an episode, s in the target; and its last state."""
    env.reset(seed=seed)
    if isinstance(policy, PlannerPolicy):
        policy.reset()
    total, over = 0.0, False
    while not over:
        _, reward, terminated, truncated, info = env.step(policy())
        total += reward * env.unwrapped.task.dt
        over = terminated or truncated
    return total, truncated


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_planner_ends_in_the_target(system):
    env = gymnasium.make(environment_id(system), action="acceleration", dt=0.005)
    ours, lasted = play(env, PlannerPolicy(env), seed=0)
    # Ten seconds less the manoeuvre, in which the reward is not 0 either.
    assert lasted and ours > 8.0


@pytest.mark.parametrize("system", ["cart-pole", "furuta", "iiwa-pendulum"])
def test_random_actions_do_not(system):
    env = gymnasium.make(environment_id(system), action="acceleration", dt=0.005)
    env.action_space.seed(0)
    random, _ = play(env, env.action_space.sample, seed=0)
    assert random < 4.0


def test_arguments_are_checked():
    with pytest.raises(upswing.InputError, match="`action`: expected"):
        gymnasium.make(environment_id("cart-pole"), action="voltage")
    with pytest.raises(upswing.InputError, match="`dt`: expected"):
        gymnasium.make(environment_id("cart-pole"), dt=0.0)
