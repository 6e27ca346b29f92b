"""Learning by trying: our environments in Stable-Baselines3's form, and a training that resumes."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from agents.learned.policy_network import SCALE, policy_network
from agents.learned.training import Schedule
from evaluation.training.reinforcement import PENALTY, REWARD_SCALE, Crosswalks, reinforce
from foresight_env.envs.crosswalk.vector import CrosswalkVectorEnv
from foresight_env.scenarios.crosswalk import CONTROL_LIMIT

pytestmark = pytest.mark.rl

SMALL = {"envs": 8, "steps": 12, "judged": 4}
SCHEDULE = Schedule(epochs=3, batch=48, rate=1e-3, patience=9)


def test_windows_end_with_what_the_environment_shows():
    """Through the end of an episode, whose last observation is not the next one's first."""
    mine = Crosswalks(3, 5)
    plain = CrosswalkVectorEnv(3, behaviour="open_loop", max_steps=5, autoreset_mode="SameStep")
    mine.begin_with(4)
    seen, (shown, _) = mine.reset(), plain.reset(seed=4)
    action = np.full((3, 2), 0.2, np.float32)
    for _ in range(7):
        last = seen.reshape(3, 4, 10)[:, -1] / SCALE
        np.testing.assert_allclose(last[:, 8:], shown[:, 8:] - shown[:, :2], atol=1e-5)
        np.testing.assert_allclose(last[:, 2:4], shown[:, 2:4], atol=1e-5)
        seen, rewards, over, told = mine.step(action)
        shown, cost, terminated, truncated, infos = plain.step(CONTROL_LIMIT * action)
        np.testing.assert_array_equal(over, terminated | truncated)
        collided = over & infos.get("final_info", {"collision": over})["collision"]
        expected = REWARD_SCALE * (cost - PENALTY * collided)
        np.testing.assert_allclose(rewards, expected, rtol=1e-5)
        for k in np.flatnonzero(over):
            final = told[k]["terminal_observation"].reshape(4, 10)[-1] / SCALE
            np.testing.assert_allclose(final[2:4], infos["final_obs"][k][2:4], atol=1e-5)
            assert told[k]["TimeLimit.truncated"] == truncated[k]
            # A new episode's window has no rows of the one before.
            window = seen[k].reshape(4, 10)
            np.testing.assert_array_equal(window[0], window[-1])


@pytest.mark.filterwarnings("ignore:You have specified a mini-batch")
def test_a_training_that_was_interrupted_ends_the_same(tmp_path):
    whole = reinforce(tmp_path / "whole", SCHEDULE, **SMALL)

    def interrupt(epoch):
        if epoch.number == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reinforce(tmp_path / "part", SCHEDULE, interrupt, **SMALL)
    again = reinforce(tmp_path / "part", SCHEDULE, **SMALL)
    assert again.curve == whole.curve
    files = [tmp_path / part / "ppo.safetensors" for part in ("whole", "part")]
    assert files[0].read_bytes() == files[1].read_bytes()
    with pytest.raises(ValueError, match="other data or another schedule"):
        reinforce(tmp_path / "part", SCHEDULE, **{**SMALL, "envs": 4})


def test_the_network_without_pytorch_says_the_same():
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy

    env = Crosswalks(1, 2)
    policy = ActorCriticPolicy(
        env.observation_space, env.action_space, lambda _: 1e-3, net_arch=[64, 64]
    )
    torch.nn.init.normal_(policy.action_net.weight)
    network = policy_network({k: v.numpy() for k, v in policy.state_dict().items()})
    seen = np.random.default_rng(0).normal(size=(5, 4, 10)).astype(np.float32)
    theirs, _ = policy.predict(SCALE * seen.reshape(5, -1), deterministic=True)
    mine = np.stack([network(one) for one in seen])
    np.testing.assert_allclose(mine, CONTROL_LIMIT * theirs, atol=1e-4)
