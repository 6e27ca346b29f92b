"""Short crossings on which all agents' tests run; one horizon, so that programs are shared."""

from dataclasses import replace

from agents import InferGamma, make_ego
from foresight_env.envs.crosswalk_v0 import parallel_env

HORIZON = 10
WINDOW = 5
AHEAD = HORIZON - WINDOW + 1
STEPS = 7


def crossing(**arguments):
    """A short crossing; agents plan over `HORIZON` stages."""
    chosen = {"planning_horizon": HORIZON, "max_steps": STEPS, "noise_std": 0.02, **arguments}
    return parallel_env(**chosen)


def ego(name):
    """A registered ego with a small window where it has one."""
    made = make_ego(name)
    return replace(made, window=WINDOW, ahead=AHEAD) if isinstance(made, InferGamma) else made


def drive(policies, seed=0, poison=None, **arguments):
    """Run an episode; per step a dict of decisions, and the infos before them.

    `policies`: by agent. `poison`: makes what the policies get of `info`.
    """
    env = crossing(**arguments)
    observations, infos = env.reset(seed=seed)
    memories = {a: policies[a].init(env.scene, a) for a in env.agents}
    decisions, truths = [], []
    while env.agents:
        step = {}
        for agent in env.agents:
            info = infos[agent] if poison is None else poison(infos[agent])
            policy = policies[agent]
            memory = policy.update(memories[agent], observations[agent], info)
            step[agent], memories[agent] = policy.act(memory)
        decisions.append(step)
        truths.append(infos)
        observations, _, _, _, infos = env.step({a: d.action for a, d in step.items()})
    return decisions, truths
