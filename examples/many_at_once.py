"""Several environments stepped together: `python examples/many_at_once.py`.

One after the other in this process, in separate processes, and as one compiled program: the
same episodes each time, since environment k of seed s has the episode of seed s + k.
"""

import gymnasium
import numpy as np
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import foresight_env.envs  # noqa: F401  (registers the environments)

ARGUMENTS = {"behaviour": "open_loop", "max_steps": 12, "planning_horizon": 6}
MODES = {
    "sync": {},
    # Linux would fork, and a fork of a process that has used JAX hangs.
    "async": {"vector_kwargs": {"context": "spawn"}},
    "vector_entry_point": {},
}


def main(count: int = 2, modes: tuple[str, ...] = tuple(MODES)) -> dict[str, np.ndarray]:
    """Returns of the first episodes, (count,), by mode."""
    returns = {}
    for mode in modes:
        env = RecordEpisodeStatistics(
            gymnasium.make_vec(
                "foresight/Crosswalk-v0",
                num_envs=count,
                vectorization_mode=mode,
                **MODES[mode],
                **ARGUMENTS,
            )
        )
        seen, _ = env.reset(seed=3)
        found = np.full(count, np.nan)
        while np.isnan(found).any():
            action = np.clip(seen[:, -2:] - seen[:, :2], -10.0, 10.0)  # towards the goal
            seen, _, _, _, infos = env.step(action.astype(np.float32))
            if "episode" in infos:
                over = infos["_episode"] & np.isnan(found)
                found[over] = infos["episode"]["r"][over]
        env.close()
        returns[mode] = found
        print(f"{mode}: returns {np.round(found, 2)}")
    return returns


if __name__ == "__main__":
    main()
