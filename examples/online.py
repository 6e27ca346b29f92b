"""Online inference with a custom policy: `python examples/online.py`

Pedestrian 0 walks to its goal by a fixed rule; from its noisy observations the estimator infers the
goal and the discount factor of pedestrian 1.
"""

from dataclasses import replace

import numpy as np

from foresight_env.envs import crosswalk_v0
from foresight_env.inverse import Free, MovingHorizonEstimator, Prior

NOISE = 0.03


def main(seed=1, steps=25):
    """Walk and infer; returns the last state of the estimator and the true discount factor."""
    env = crosswalk_v0.parallel_env(players=2, noise_std=NOISE)
    observations, infos = env.reset(seed=seed)
    scene, agent = env.scene, env.agents[0]
    own = scene.own(0)
    estimator = MovingHorizonEstimator(
        replace(scene.game, horizon=24),  # 10 observed stages, 15 predicted
        scene.observation_model(0),
        free=(Free((), gamma=False, initial_state=True), Free(("goal",), True, True)),
        covariance=NOISE**2,
        prior=Prior(gamma_weight=4.0, theta_deviation=(("goal", 3.0),)),  # gamma about 1 +- 0.5
        forgetting_factor=1.5,  # others re-plan, so old observations say less
    )
    # First guess of pedestrian 1: our weights, and its present position as goal.
    theta = [own.theta, {**own.theta, "goal": observations[agent][4:6]}]
    state = estimator.init(theta, [own.gamma, 0.8])
    for step in range(steps):
        seen, goal = observations[agent][:-2], observations[agent][-2:]  # the goal is our own
        state = estimator.update(state, seen)
        if state.present is not None and step % 4 == 0:
            mean, deviation = state.gamma[1], state.gamma_deviation[1]
            place = state.present[1][:2]
            print(f"{step * scene.dt:.1f} s: gamma {mean:.2f} +- {deviation:.2f}, at {place}")
        action = np.clip(2.0 * (goal - seen[:2]) - 3.0 * seen[2:4], -2.0, 2.0)
        observations, _, _, _, infos = env.step({agent: action.astype(np.float32)})
        if not env.agents:
            break
        truth = float(infos[agent]["gamma"][1])
    print(
        f"true gamma {truth:.2f}, failed updates {state.failures}, "
        f"reduced chi-squared {state.reduced_chi_squared:.1f}"
    )
    return state, truth


if __name__ == "__main__":
    main()
