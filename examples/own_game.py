"""A custom game: a lane change next to another car. `python examples/own_game.py`

Defined, solved, verified, inverted from noisy observations, and solved for a thousand episodes.
"""

from dataclasses import dataclass

import numpy as np

from foresight_env.equilibrium import Status, solve, solve_many, verify
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Game,
    Player,
    SharedInequality,
    SharedMinimumDistance,
    full_state,
)  # fmt: skip
from foresight_env.inverse import Free, MultiStart, estimate

LANE = 3.5


@dataclass(frozen=True)
class Cruise:
    """`(py - lane)^2 + (vx - speed)^2`: a stage cost is any hashable function like this one."""

    def __call__(self, i, t, x, u, theta):
        return (x[i][1] - theta["lane"]) ** 2 + (x[i][2] - theta["speed"]) ** 2


def lane_change(horizon=15, dt=0.2):
    """Two cars `[px, py, vx, vy]` on a road of two lanes, never less than 2 m (4 m^2) apart."""
    road = Bounds.box([-np.inf, -1.5, 0.0, -3.0], [np.inf, LANE + 1.5, 15.0, 3.0], 4)
    limits = Bounds.box([-6.0, -4.0], [4.0, 4.0], 2)
    costs = (Cruise(), Effort(0.1))
    car = Player(DoubleIntegrator(dt), costs, state_bounds=road, control_bounds=limits)
    return Game((car, car), horizon, shared=(SharedInequality(SharedMinimumDistance(4.0), 1),))


def draw(random):
    """Car 0 moves over to the lane of car 1, somewhere next to it: states, theta, gamma."""
    speed = random.uniform(4.0, 8.0, 2)
    beside = random.uniform(-4.0, 4.0)
    states = np.array([[0.0, 0.0, speed[0], 0.0], [beside, LANE, speed[1], 0.0]])
    theta = [{"lane": LANE, "speed": v} for v in speed + random.uniform(0.0, 2.0, 2)]
    return states, theta, random.uniform(0.3, 1.0, 2)


def main():
    """Solve, verify, infer, solve many; returns true and inferred discount factors."""
    game = lane_change()
    states, theta, gamma = draw(np.random.default_rng(1))
    played = solve(game, states, theta, gamma, throw=True)
    print("local equilibrium:", bool(verify(game, played, theta, gamma).is_local_equilibrium))
    seen = np.concatenate(played.states, axis=1)
    seen = seen + 0.03 * np.random.default_rng(0).standard_normal(seen.shape)
    found = estimate(
        game, seen, full_state(game.state_sizes), initial_state=states, theta=theta, gamma=0.8,
        free=Free(("speed",), gamma=True), covariance=0.03**2, starts=MultiStart(4),
    )  # fmt: skip
    for i, (mean, deviation) in enumerate(zip(found.gamma, found.gamma_deviation, strict=True)):
        print(f"gamma of car {i}: {mean:.2f} +- {deviation:.2f}, true {gamma[i]:.2f}")
    drawn = [draw(np.random.default_rng(k)) for k in range(1000)]
    initial_state, thetas, gammas = zip(*drawn, strict=True)
    many = solve_many(game, np.stack(initial_state), thetas, np.stack(gammas))
    print(f"solved {np.mean(many.status == Status.SOLVED):.1%} of 1000")
    return gamma, found.gamma


if __name__ == "__main__":
    main()
