"""Games whose dynamics bend: curvature, driven steps, and cars that must turn."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import SolverOptions
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.curvature import dynamics_hessian, positive_part
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import evaluate
from foresight_env.equilibrium.conditions.rollout import feedback_rollout, rollout
from foresight_env.equilibrium.linear_algebra.stagewise import factorise
from foresight_env.equilibrium.newton.newton_system import (
    direction,
    eliminate_pairs,
    on_the_path,
    stage_system,
)
from foresight_env.equilibrium.newton.start import begin
from foresight_env.equilibrium.settings import Softness
from foresight_env.games import (
    Bounds,
    DoubleIntegrator,
    Effort,
    Game,
    Goal,
    Inequality,
    KinematicBicycle,
    MinimumDistance,
    Player,
    SharedInequality,
    SharedMinimumDistance,
)


@pytest.fixture(autouse=True, scope="module")
def double_precision():
    with jax.enable_x64(True):
        yield


def mixed(horizon=3):
    """A person between two cars: linear and nonlinear players interleave."""
    costs = (Goal(1.0), Effort(1.0))
    person = Player(DoubleIntegrator(0.2), costs)
    car = Player(KinematicBicycle(0.2, 1.5), costs, control_bounds=Bounds.box(-0.4, 0.4, 2))
    return layout_of(Game((car, person, car), horizon))


def numbers(layout, seed):
    random = np.random.default_rng(seed)
    horizon, n, m = layout.game.horizon, layout.n, layout.m
    return (
        jnp.asarray(random.normal(size=(horizon, n))),
        jnp.asarray(random.uniform(-0.3, 0.3, (horizon, m))),
        jnp.asarray(random.normal(size=(horizon, n))),
    )


@pytest.mark.parametrize("size", [1, 3, 6])
def test_the_positive_part_has_the_positive_eigenvalues(size):
    random = np.random.default_rng(size)
    basis = np.linalg.qr(random.normal(size=(5, size, size)))[0]
    values = random.choice([-1.0, 1.0], (5, size)) * random.uniform(0.1, 1.0, (5, size))
    matrices = (basis * values[:, None, :]) @ np.swapaxes(basis, 1, 2)
    kept = (basis * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(basis, 1, 2)
    for scale in (1e-6, 1.0, 1e6):
        found = np.asarray(positive_part(jnp.asarray(scale * matrices)))
        np.testing.assert_allclose(found, scale * kept, atol=0.02 * scale)
    np.testing.assert_array_equal(positive_part(jnp.zeros((2, 3, 3))), 0.0)


def test_curvature_of_dynamics_is_the_second_derivative():
    layout, one = mixed(), mixed(1)
    previous, u, q = numbers(layout, 0)
    found = dynamics_hessian(layout, previous, u, q)

    def value(w, costate):
        return jnp.dot(costate, rollout(one, w[: one.n], w[None, one.n :])[0])

    places = jnp.concatenate([previous, u], axis=1)
    np.testing.assert_allclose(found, jax.vmap(jax.hessian(value))(places, q), atol=1e-12)
    convex = dynamics_hessian(layout, previous, u, q, jnp.asarray(1.0))
    least = np.linalg.eigvalsh(np.asarray(convex)).min()
    assert least > -0.05 * np.abs(np.asarray(found)).max()
    kept = dynamics_hessian(layout, previous, u, q, jnp.asarray(0.0))
    np.testing.assert_array_equal(kept, found)
    between = dynamics_hessian(layout, previous, u, q, jnp.asarray(0.25))
    np.testing.assert_allclose(between, 0.25 * convex + 0.75 * found, atol=1e-12)


def test_a_driven_step_without_gain_is_a_rollout_within_bounds():
    layout = mixed()
    previous, u, _ = numbers(layout, 1)
    x = rollout(layout, previous[0], u)
    before = jnp.concatenate([previous[:1], x[:-1]])
    du = jnp.full_like(u, 0.3)
    gain = jnp.zeros((*u.shape, layout.n))
    states, controls = feedback_rollout(
        layout, before, u, jnp.ones_like(x), du, gain, jnp.asarray(0.5)
    )
    low, high = layout.bounds
    np.testing.assert_allclose(controls, np.clip(u + 0.15, low[:, layout.n :], high[:, layout.n :]))
    np.testing.assert_allclose(states, rollout(layout, previous[0], controls))


def test_a_driven_step_of_linear_dynamics_is_the_straight_one():
    player = Player(DoubleIntegrator(0.2), (Goal(1.0), Effort(1.0)))
    layout, one = (layout_of(Game((player, player), horizon)) for horizon in (4, 1))
    previous, u, _ = numbers(layout, 2)
    x = rollout(layout, previous[0], u)
    before = jnp.concatenate([previous[:1], x[:-1]])
    random = np.random.default_rng(3)
    gain = jnp.asarray(random.normal(size=(4, layout.m, layout.n)))
    feedforward = jnp.asarray(random.normal(size=u.shape))
    states, changes = [jnp.zeros(layout.n)], []
    for t in range(4):
        changes.append(gain[t] @ states[-1] + feedforward[t])
        states.append(rollout(one, states[-1], changes[-1][None])[0])
    dx, du = jnp.stack(states[1:]), jnp.stack(changes)
    found = feedback_rollout(layout, before, u, dx, du, gain, jnp.asarray(1.0))
    np.testing.assert_allclose(found[0], x + dx, atol=1e-10)
    np.testing.assert_allclose(found[1], u + du, atol=1e-10)


def test_a_newton_step_solves_the_linearised_conditions():
    """Hard, elastic and common shared rows: multipliers are eliminated, and recovered."""
    hard, elastic = Inequality(MinimumDistance(0.5), 1), Inequality(MinimumDistance(1.5), 1, 4.0)
    costs = (Goal(1.0), Effort(1.0))
    car = Player(KinematicBicycle(0.2, 1.5), costs, inequalities=(hard, elastic))
    shared = (SharedInequality(SharedMinimumDistance(0.8), 1, "common"),)
    game = Game((car, car), 4, shared)
    layout, options = layout_of(game), SolverOptions()
    states = np.array([[0.0, 0.0, 1.0, 0.1], [2.0, 0.3, 1.0, 3.0]])
    theta = [{"goal": np.array([2.0, 0.0])}, {"goal": np.array([0.0, 0.5])}]
    parameters = jax.tree.map(
        jnp.asarray, check_parameters(game, states, theta, np.array([0.7, 0.9]))
    )
    pairs, point = pairs_of(layout), begin(layout, options, parameters, None).point
    ev = evaluate(layout, pairs, point, parameters, jnp.zeros(()), options.barrier)
    linear = on_the_path(pairs, point, jnp.asarray(0.05))

    @jax.jit
    def step():
        eliminated = eliminate_pairs(layout, pairs, linear, Softness.least)
        factor = factorise(stage_system(layout, point, ev, eliminated), layout.equal_sizes)
        return direction(layout, pairs, ev, factor, eliminated, linear)

    taken = step()
    products = linear.slope * taken.slack + linear.own * taken.mult
    np.testing.assert_allclose(products, linear.target, atol=1e-7)

    # A small part of the step changes every residual by that part of itself.
    part = 1e-6
    ahead = jax.tree.map(lambda v, change: v + part * change, point, taken)
    after = evaluate(layout, pairs, ahead, parameters, jnp.zeros(()), options.barrier).residual
    for name, old, new in zip(ev.residual._fields, ev.residual, after, strict=True):
        np.testing.assert_allclose((new - old) / part, -old, atol=2e-3, err_msg=name)
