"""Games between smooth strategies: by definition, by differences, against the general solver."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agents.hybrid.smooth_game import (
    NO_LENGTH,
    Basis,
    Bodies,
    Frames,
    SmoothGame,
    Traits,
    cost,
    equilibrium,
    gradients,
    positions,
)
from agents.hybrid.strategies import GAME_BASIS as BASIS
from foresight_env.equilibrium import Status, solve
from foresight_env.games import DoubleIntegrator, Effort, ExponentialPerSecond, Game, Player

STEP = 0.4
"""s."""
COST, GRADIENTS, EQUILIBRIUM = map(jax.jit, (cost, gradients, equilibrium))


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64(True):
        yield


def crossing(conflict=5.0, vehicle=False, gamma=(0.3, 0.9, 0.6)):
    """Three agents whose preferred motions cross."""
    angle = jnp.array([0.0, 1.6, 2.9])
    rotation = jnp.stack(
        [
            jnp.stack([jnp.cos(angle), -jnp.sin(angle)], -1),
            jnp.stack([jnp.sin(angle), jnp.cos(angle)], -1),
        ],
        -2,
    )
    velocity = 1.2 * rotation[..., 0]
    place = jnp.array([[-2.5, 0.1], [0.0, -2.6], [2.6, -0.3]])
    frames = Frames(place, velocity, rotation)
    kinds = jnp.array([vehicle, False, False])
    bodies = Bodies(
        jnp.where(kinds, 2.2, 0.3), jnp.where(kinds, 0.9, 0.3), kinds, jnp.ones(3, bool)
    )
    traits = Traits(
        jnp.array(gamma), jnp.full(3, 0.2), jnp.full(3, conflict), jnp.array([0.3, 0.5, 0.4])
    )
    preferred = 0.1 * jax.random.normal(jax.random.key(3), (3, BASIS.value.shape[1], 2))
    return SmoothGame(frames, bodies, traits, preferred)


@pytest.mark.parametrize("vehicle", [False, True])
def test_gradients_and_newtons_matrix_are_derivatives_of_the_costs(vehicle):
    from agents.hybrid.smooth_game import _jacobian

    game = crossing(vehicle=vehicle)
    strategy = game.preferred + 0.02
    whole = jax.jacobian(COST, argnums=1)(game, strategy, BASIS)
    own = jnp.stack([whole[i, i] for i in range(3)])
    np.testing.assert_allclose(GRADIENTS(game, strategy, BASIS), own, atol=1e-9)
    count = own.size
    matrix = jax.jacobian(GRADIENTS, argnums=1)(game, strategy, BASIS).reshape(count, count)
    found = _jacobian(game, strategy, BASIS, jnp.ones(()))
    np.testing.assert_allclose(found, matrix, atol=1e-3)  # up to the regularisation


@pytest.mark.parametrize("vehicle", [False, True])
def test_no_agent_gains_by_another_strategy(vehicle):
    game = crossing(vehicle=vehicle)
    found = EQUILIBRIUM(game, BASIS)
    assert found.solved
    best = COST(game, found.strategy, BASIS)
    assert float(jnp.abs(found.strategy - game.preferred).max()) > 1e-2  # they do meet
    for seed in range(30):
        noise = 10.0 ** -(seed % 3) * jax.random.normal(jax.random.key(seed), game.preferred.shape)
        for i in range(3):
            other = found.strategy.at[i].add(0.05 * noise[i])
            assert COST(game, other, BASIS)[i] >= best[i] - 1e-9


def test_who_meets_no_one_moves_as_preferred():
    game = crossing(conflict=0.0)
    np.testing.assert_allclose(EQUILIBRIUM(game, BASIS).strategy, game.preferred, atol=1e-12)
    empty = crossing()
    empty = empty._replace(bodies=empty.bodies._replace(there=jnp.array([True, False, False])))
    np.testing.assert_allclose(EQUILIBRIUM(empty, BASIS).strategy, empty.preferred, atol=1e-12)


def test_derivatives_of_the_equilibrium_by_differences():
    game = crossing()

    def final(gamma, margin, preferred):
        traits = game.traits._replace(gamma=gamma, margin=margin)
        changed = game._replace(traits=traits, preferred=preferred)
        return positions(game.frames, EQUILIBRIUM(changed, BASIS).strategy, BASIS)[:, -4:].sum(1)

    at = game.traits.gamma, game.traits.margin, game.preferred
    exact = jax.jacobian(final, argnums=(0, 1, 2))(*at)
    step = 1e-5
    for k, (value, found) in enumerate(zip(at, exact, strict=True)):
        direction = jax.random.normal(jax.random.key(k), value.shape)
        plus, minus = (
            final(*[v + s * step * direction if j == k else v for j, v in enumerate(at)])
            for s in (1.0, -1.0)
        )
        wanted = jnp.tensordot(found, direction, axes=value.ndim)
        np.testing.assert_allclose((plus - minus) / (2 * step), wanted, rtol=2e-3, atol=2e-4)


def test_a_game_without_a_solution_falls_back_to_the_preferred_motion():
    game = crossing(conflict=jnp.nan)
    found = EQUILIBRIUM(game, BASIS)
    assert not found.solved
    np.testing.assert_array_equal(found.strategy, game.preferred)


@dataclass(frozen=True)
class Track:
    """`|p - line|^2`, the line of straight motion from `place` with `velocity`."""

    def __call__(self, i, t, x, u, theta):
        line = theta["place"] + t * STEP * theta["velocity"]
        return jnp.sum((x[i][:2] - line) ** 2)


@dataclass(frozen=True)
class Room:
    """`conflict * depth^2` of all others in circles, as smooth games have them."""

    players: int

    def __call__(self, i, t, x, u, theta):
        found = 0.0
        for j in range(self.players):
            if j != i:
                width = theta["width"]
                rho = jnp.sqrt(jnp.sum((x[i][:2] - x[j][:2]) ** 2) / width**2 + NO_LENGTH**2)
                found += theta["conflict"] * (jnp.maximum(1.0 - rho, 0.0) * width) ** 2
        return found


def test_with_free_accelerations_it_is_the_equilibrium_of_the_general_solver():
    """Strategies of one acceleration per step and axis are those of a double integrator."""
    steps = 12
    number = np.arange(steps)
    # Acceleration b acts from b to b + 1 and moves the agent from then on.
    late = number[:, None] - number[None] + 0.5
    basis = Basis(STEP * (number + 1.0), np.where(late > 0.0, STEP**2 * late, 0.0), np.eye(steps))
    game = crossing(conflict=20.0)
    game = game._replace(preferred=jnp.zeros((3, steps, 2)))
    found = EQUILIBRIUM(game, basis)
    assert found.solved
    frames, traits = game.frames, game.traits
    players = tuple(
        Player(
            DoubleIntegrator(STEP),
            (Track(), Effort("effort"), Room(3)),
            discounting=ExponentialPerSecond(STEP),
        )
        for _ in range(3)
    )
    theta = [
        {
            "place": frames.place[i],
            "velocity": frames.velocity[i],
            "effort": traits.effort[i],
            "conflict": traits.conflict[i],
            "width": 0.6 + traits.margin[i],
        }
        for i in range(3)
    ]
    states = [jnp.concatenate([frames.place[i], frames.velocity[i]]) for i in range(3)]
    mine = np.asarray(positions(frames, found.strategy, basis))
    controls = np.einsum("aik,abk->abi", frames.rotation, found.strategy)
    solved = solve(
        Game(players, steps, (), STEP), states, theta, list(traits.gamma),
        initial_guess=list(np.asarray(controls)),
    )  # fmt: skip
    assert int(solved.status) == Status.SOLVED
    theirs = np.stack([np.asarray(x)[1:, :2] for x in solved.states])
    assert np.abs(theirs - np.asarray(positions(frames, game.preferred, basis))).max() > 0.1
    np.testing.assert_allclose(mine, theirs, atol=2e-3)
