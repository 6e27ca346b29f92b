"""Implicit derivatives against central differences; `vmap` against a loop; single precision."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.merge import draw, merge_game
from foresight_env.equilibrium import WEAK_COMPLEMENTARITY, SolverOptions, Status, solve
from tests.support.small_games import (
    CROSSING_GAMMA,
    CROSSING_GOALS,
    CROSSING_STATES,
    TIGHT,
    UNEQUAL_STATES,
    UNEQUAL_THETA,
    crossing,
    crossing_theta,
    unequal_sizes,
)

# All that an equilibrium depends on, as one vector: initial_state (8), goals (4), price, gammas
# (2).
POINT = np.concatenate([CROSSING_STATES.ravel(), CROSSING_GOALS.ravel(), [2.0], CROSSING_GAMMA])


def solved(kind, v, options=TIGHT):
    theta = crossing_theta(v[8:12].reshape(2, 2), v[12])
    return solve(crossing(kind), v[:8].reshape(2, 4), theta, v[13:], options=options)


def trajectory(kind, v, options=TIGHT):
    found = solved(kind, v, options)
    parts = [*(s[1:] for s in found.states), *found.controls]
    return jnp.concatenate([p.ravel() for p in parts])


def central_differences(kind, step=1e-5):
    columns = []
    for k in range(POINT.size):
        shift = step * np.eye(POINT.size)[k]
        ends = []
        for v in (POINT + shift, POINT - shift):
            found = solved(kind, v)
            assert found.status == Status.SOLVED
            parts = [*(s[1:] for s in found.states), *found.controls]
            ends.append(np.concatenate([p.ravel() for p in parts]))
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("kind", ["soft", "reference", "hard"])
def test_forward_and_reverse_derivatives_are_those_of_the_solution(kind):
    at = solved(kind, POINT)
    assert at.status == Status.SOLVED
    assert at.margin > WEAK_COMPLEMENTARITY
    expected = central_differences(kind)
    assert np.abs(expected[:, 13:]).max() > 1e-2  # foresight matters here
    with jax.enable_x64(True):
        # Both modes from one linearisation: its tangent map, and that map transposed.
        _, tangent = jax.linearize(partial(trajectory, kind), jnp.asarray(POINT))
        forward = np.asarray(jax.vmap(tangent, out_axes=1)(jnp.eye(POINT.size)))
        pull = np.random.default_rng(0).normal(size=expected.shape[0])
        (reverse,) = jax.linear_transpose(tangent, jnp.asarray(POINT))(jnp.asarray(pull))
    tolerance = 1e-5 * np.abs(expected).max()
    np.testing.assert_allclose(forward, expected, rtol=1e-5, atol=tolerance)
    np.testing.assert_allclose(np.asarray(reverse), pull @ forward, rtol=1e-7, atol=1e-7)


# The same for a bicycle (nonlinear dynamics) that meets a walker: initial_state (6), goals (4),
# gammas (2).
UNEQUAL = np.concatenate([*UNEQUAL_STATES, *(t["goal"] for t in UNEQUAL_THETA), [0.9, 0.6]])


def unequal_trajectory(v):
    theta = [{"goal": v[6:8]}, {"goal": v[8:10]}]
    found = solve(unequal_sizes(), [v[:4], v[4:6]], theta, v[10:], options=TIGHT)
    parts = [*(s[1:] for s in found.states), *found.controls]
    return (jnp if isinstance(v, jax.Array) else np).concatenate([p.ravel() for p in parts])


def test_derivatives_are_right_where_dynamics_are_not_linear():
    step = 1e-5
    columns = [
        (unequal_trajectory(UNEQUAL + step * e) - unequal_trajectory(UNEQUAL - step * e))
        / (2.0 * step)
        for e in np.eye(UNEQUAL.size)
    ]
    expected = np.stack(columns, axis=1)
    with jax.enable_x64(True):
        _, tangent = jax.linearize(unequal_trajectory, jnp.asarray(UNEQUAL))
        forward = np.asarray(jax.vmap(tangent, out_axes=1)(jnp.eye(UNEQUAL.size)))
    np.testing.assert_allclose(forward, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())


def test_derivatives_keep_their_accuracy_where_hard_shared_rows_are_active():
    """Three cars that merge, whose controls reach positions two stages later, at little cost."""
    game, theta, state = merge_game(3), [{}] * 3, draw(3, seed=2)
    direction = np.random.default_rng(0).normal(size=state.shape)

    def reached(v):
        found = solve(game, v, theta, 1.0, options=TIGHT)
        return found, [*(s[1:] for s in found.states), *found.controls, found.point.mult]

    found, _ = reached(state)
    assert found.status == Status.SOLVED
    assert found.margin > WEAK_COMPLEMENTARITY
    assert found.point.mult.max() > 0.1
    step = 1e-4
    ends = [reached(state + sign * step * direction)[1] for sign in (1.0, -1.0)]
    with jax.enable_x64(True):
        at, along = jnp.asarray(state), jnp.asarray(direction)
        _, rates = jax.jvp(lambda v: reached(v)[1], (at,), (along,))
    for rate, up, down in zip(rates, *ends, strict=True):
        np.testing.assert_allclose(rate, (up - down) / (2 * step), atol=2e-5)


def test_vmap_is_a_loop():
    gammas = np.array([[0.9, 0.7], [0.5, 1.0], [1.05, 0.3]])
    theta = crossing_theta()
    with jax.enable_x64(True):
        batch = jax.vmap(lambda g: solve(crossing("soft"), CROSSING_STATES, theta, g))(
            jnp.asarray(gammas)
        )
    batch = jax.tree.map(np.asarray, batch)
    for k, gamma in enumerate(gammas):
        one = solve(crossing("soft"), CROSSING_STATES, theta, gamma)
        assert one.status == Status.SOLVED
        assert batch.status[k] == Status.SOLVED
        np.testing.assert_allclose(batch.states[0][k], one.states[0], atol=1e-8)
        np.testing.assert_allclose(batch.controls[1][k], one.controls[1], atol=1e-8)


def test_concrete_calls_return_doubles_whatever_the_callers_precision():
    assert not jax.config.read("jax_enable_x64")
    found = solved("soft", POINT, SolverOptions())
    assert isinstance(found.states[0], np.ndarray)
    assert found.states[0].dtype == np.float64
    assert not jax.config.read("jax_enable_x64")
    assert jnp.ones(1).dtype == jnp.float32


def test_single_precision_callers_may_trace_and_differentiate():
    """Warnings are errors here: no truncation of doubles is reported either."""

    def last(gamma):
        found = solve(crossing("soft"), CROSSING_STATES, crossing_theta(), gamma)
        return jnp.sum(found.states[0][-1] * jnp.arange(1.0, 5.0)), found

    gamma = jnp.asarray(CROSSING_GAMMA, jnp.float32)
    (value, found), slope = jax.jit(jax.value_and_grad(last, has_aux=True))(gamma)
    assert found.states[0].dtype == jnp.float32
    assert found.status == Status.SOLVED
    assert not jax.config.read("jax_enable_x64")
    exact = solved("soft", POINT, SolverOptions())
    weights = np.arange(1.0, 5.0)
    assert float(value) == pytest.approx(exact.states[0][-1] @ weights, rel=1e-5)
    step = 1e-5
    for i in range(2):
        up, down = (
            solved("soft", POINT + sign * step * np.eye(POINT.size)[13 + i]).states[0][-1] @ weights
            for sign in (1, -1)
        )
        assert float(slope[i]) == pytest.approx((up - down) / (2 * step), rel=1e-3, abs=1e-4)
