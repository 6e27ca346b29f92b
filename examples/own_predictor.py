"""A custom predictor, a plain function: `python examples/own_predictor.py`.

It is checked and compared with the library's on simulated crossings. On the command line it is
`own_predictor:slowing` (from this folder, or any folder where Python finds the module):

    foresight benchmark --scenarios crosswalk --predictors kalman,own_predictor:slowing \\
        --egos kalman+plan,own_predictor:slowing+plan
"""

import numpy as np

from agents import FunctionPredictor, History, make_predictor
from agents.conformance import check_predictor
from evaluation.metrics.prediction import judged
from evaluation.windows.simulated import simulated_windows

RELAXATION = 2.0
"""Time in which an agent loses two thirds of its speed, s."""


def slowing(history: History, steps: int) -> np.ndarray:
    """Agents slow down: positions (steps, N, 2), m."""
    times = history.dt * np.arange(1, steps + 1)
    paths = []
    for i in range(len(history.kinds)):
        last = history.seen(i)[-1]  # an agent out of sight was observed before
        state, age = history.states[last, i], history.dt * (len(history.states) - 1 - last)
        way = RELAXATION * (1.0 - np.exp(-(age + times) / RELAXATION))
        paths.append(state[:2] + way[:, None] * state[2:])
    return np.stack(paths, axis=1)


def main(episodes: int = 5) -> dict[str, float]:
    """Mean displacement errors (m) on simulated crossings."""
    mine = FunctionPredictor(slowing, "slowing")
    check_predictor(mine)
    errors: dict[str, float] = {}
    for predictor in (mine, make_predictor("constant-velocity"), make_predictor("kalman")):
        found = [
            judged(w.history, w.truth, predictor.predict(w.history, len(w.truth)))["average_error"]
            for seed in range(episodes)
            for w in simulated_windows("crosswalk", seed)
        ]
        errors[predictor.name] = float(np.mean(found))
        print(f"{predictor.name}: {errors[predictor.name]:.2f} m in {len(found)} windows")
    return errors


if __name__ == "__main__":
    main()
