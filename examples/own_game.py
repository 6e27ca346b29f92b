"""A game of one's own: a lane change beside another car. `python examples/own_game.py`

Car 0 wants to move to the lane of car 1, which drives a little ahead and pays less heed to the
future. Both want their lane and their speed; they must keep 4 m apart. The game is solved,
verified, and the discount factors are inferred back from noisy observations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from foresight_env.equilibrium import solve, verify
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Game,
    KeepAllApart,
    Player,
    SharedInequality,
    full_state,
)
from foresight_env.inverse import Free, MultiStart, estimate


@dataclass(frozen=True)
class Cruise:
    """`(py - lane)^2 + (vx - speed)^2`: a stage cost is any hashable function like this one."""

    def __call__(self, i: int, t: Any, x: Any, u: Any, theta: Any) -> Any:
        return (x[i][1] - theta["lane"]) ** 2 + (x[i][2] - theta["speed"]) ** 2


def lane_change(horizon: int = 15, dt: float = 0.2) -> Game:
    """Two double integrators `[px, py, vx, vy]` that accelerate at most 4 m/s^2 per axis."""
    car = Player(
        DoubleIntegrator(dt), (Cruise(), Effort(0.3)), control_bounds=Bounds.box(-4.0, 4.0, 2)
    )
    return Game((car, car), horizon, shared=(SharedInequality(KeepAllApart(16.0), 1),), dt=dt)


def main() -> np.ndarray:
    """Solve, verify, infer; returns the inferred discount factors."""
    game, gamma = lane_change(), np.array([0.95, 0.7])
    start = [np.array([0.0, 0.0, 10.0, 0.0]), np.array([2.0, 4.0, 9.0, 0.0])]
    theta = [{"lane": 3.5, "speed": 10.0}, {"lane": 3.5, "speed": 10.0}]
    played = solve(game, start, theta, gamma, throw=True)
    checked = verify(game, played, theta, gamma)
    gap = np.linalg.norm(played.states[0][:, :2] - played.states[1][:, :2], axis=1).min()
    print(f"solved in {played.iterations} iterations, residual {played.residual:.0e}")
    print(f"local equilibrium: {bool(checked.is_local_equilibrium)}, least distance {gap:.2f} m")
    random = np.random.default_rng(0)
    seen = np.concatenate(played.states, axis=1)
    seen = seen + 0.03 * random.standard_normal(seen.shape)
    found = estimate(
        game, seen, full_state(game.state_sizes), initial_state=start, theta=theta, gamma=0.8,
        free=Free(("speed",), gamma=True), covariance=0.03**2, starts=MultiStart(4),
    )  # fmt: skip
    for i, (mean, deviation) in enumerate(zip(found.gamma, found.gamma_deviation, strict=True)):
        print(f"gamma of car {i}: {mean:.2f} +- {deviation:.3f}, true {gamma[i]:.2f}")
    return found.gamma


if __name__ == "__main__":
    main()
