"""All agents learn, with TorchRL: `python examples/train_torchrl.py` (needs torchrl).

PettingZoo's parallel environment with all agents controlled; pedestrians share one policy and one
value network, which multi-agent PPO trains (Yu et al., NeurIPS 2022, without a central critic).
"""

import torch
from pettingzoo.utils import BaseParallelWrapper
from tensordict.nn import NormalParamExtractor, TensorDictModule
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer, SamplerWithoutReplacement
from torchrl.envs import PettingZooWrapper, RewardSum, TransformedEnv
from torchrl.modules import MultiAgentMLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from foresight_env.envs import crosswalk_v0

GROUP = "pedestrian"
PLAYERS = 2
DISCOUNT = 0.95
SEEN = (GROUP, "observation")


class Blindfold(BaseParallelWrapper):
    """Removes `infos`: they hold the ground truth, and TorchRL expects plain arrays."""

    def reset(self, seed=None, options=None):
        """Observations only."""
        observations, infos = self.env.reset(seed=seed, options=options)
        return observations, {agent: {} for agent in infos}

    def step(self, actions):
        """Everything but the information."""
        *results, infos = self.env.step(actions)
        return (*results, {agent: {} for agent in infos})


def make(steps: int = 30) -> TransformedEnv:
    """A crosswalk in which all agents learn; episodes have a return."""
    env = crosswalk_v0.parallel_env(players=PLAYERS, controlled="all", max_steps=steps)
    wrapped = PettingZooWrapper(Blindfold(env), categorical_actions=False)
    episode = (GROUP, "episode_reward")
    return TransformedEnv(wrapped, RewardSum(in_keys=[(GROUP, "reward")], out_keys=[episode]))


def network(inputs: int, outputs: int) -> MultiAgentMLP:
    """One network for all agents, each with its own observation."""
    return MultiAgentMLP(
        n_agent_inputs=inputs,
        n_agent_outputs=outputs,
        n_agents=PLAYERS,
        centralised=False,
        share_params=True,
        depth=2,
        num_cells=64,
        activation_class=torch.nn.Tanh,
    )


def main(batches: int = 20, frames: int = 600) -> list[float]:
    """Mean return per batch of episodes."""
    torch.manual_seed(0)
    env = make()
    size = env.observation_spec[SEEN].shape[-1]
    space = env.full_action_spec_unbatched[GROUP, "action"].space
    policy = ProbabilisticActor(
        TensorDictModule(
            torch.nn.Sequential(network(size, 4), NormalParamExtractor()),
            in_keys=[SEEN],
            out_keys=[(GROUP, "loc"), (GROUP, "scale")],
        ),
        in_keys=[(GROUP, "loc"), (GROUP, "scale")],
        out_keys=[(GROUP, "action")],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": space.low, "high": space.high},
        return_log_prob=True,
        log_prob_key=(GROUP, "log_prob"),
    )
    critic = TensorDictModule(network(size, 1), in_keys=[SEEN], out_keys=[(GROUP, "state_value")])
    loss = ClipPPOLoss(policy, critic, entropy_coeff=0.01)
    loss.set_keys(
        reward=(GROUP, "reward"),
        action=(GROUP, "action"),
        sample_log_prob=(GROUP, "log_prob"),
        value=(GROUP, "state_value"),
        done=(GROUP, "done"),
        terminated=(GROUP, "terminated"),
    )
    loss.make_value_estimator(ValueEstimators.GAE, gamma=DISCOUNT, lmbda=0.9)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    collector = Collector(env, policy, frames_per_batch=frames, total_frames=frames * batches)
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=100
    )
    returns = []
    for batch in collector:
        with torch.no_grad():
            loss.value_estimator(
                batch,
                params=loss.critic_network_params,
                target_params=loss.target_critic_network_params,
            )
        buffer.extend(batch.reshape(-1))
        for _ in range(4 * frames // 100):
            losses = loss(buffer.sample())
            total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
            total.backward()
            torch.nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
            optimiser.step()
            optimiser.zero_grad()
        over = batch["next", GROUP, "done"]
        returns.append(float(batch["next", GROUP, "episode_reward"][over].mean()))
        print(f"batch {len(returns)}: mean return {returns[-1]:.1f}")
    collector.shutdown()
    return returns


if __name__ == "__main__":
    main()
