"""Discounting functions: weights, ratios, and their limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import CustomDiscounting, Exponential, ExponentialPerSecond, Hyperbolic
from foresight_env.games.discounting import Discounting


def quasi_hyperbolic(t, gamma):
    """log Gamma: everything later counts 0.7 of what it did, then exponentially."""
    return t * jnp.log(gamma) + jnp.where(t > 1, jnp.log(0.7), 0.0)


FAMILIES = [
    Exponential(),
    ExponentialPerSecond(0.4),
    Hyperbolic(),
    CustomDiscounting(quasi_hyperbolic),
]


def both(family, gamma, stages=6):
    """Weights at 1..stages and ratios at 0..stages - 1."""
    with jax.enable_x64(True):
        t = jnp.arange(1.0, stages + 1)
        g = jnp.asarray(gamma)
        weights = jax.vmap(lambda s: jnp.asarray(family.weight(s, g)))(t)
        ratios = jax.vmap(lambda s: jnp.asarray(family.ratio(s, g)))(t - 1.0)
    return np.asarray(weights), np.asarray(ratios)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda f: type(f).__name__)
@pytest.mark.parametrize("gamma", [0.05, 0.5, 0.9, 1.0])
def test_ratios_lead_from_each_weight_to_the_next(family, gamma):
    weights, ratios = both(family, gamma)
    assert isinstance(family, Discounting)
    np.testing.assert_allclose(weights[:-1] * ratios[1:], weights[1:], rtol=1e-12)
    assert (weights > 0).all()


@pytest.mark.parametrize("gamma", [0.3, 1.0, 1.1])
def test_exponential_is_a_power(gamma):
    weights, ratios = both(Exponential(), gamma)
    np.testing.assert_allclose(weights, gamma ** np.arange(1, 7), rtol=1e-12)
    np.testing.assert_allclose(ratios, gamma)


def test_exponential_at_zero_is_myopic_without_dividing_by_zero():
    _, ratios = both(Exponential(), 0.0)
    assert (ratios == 0.0).all()


def test_exponential_ratio_survives_where_the_weight_underflows():
    with jax.enable_x64(True):
        family, gamma, t = Exponential(), jnp.asarray(1e-3), jnp.asarray(200.0)
        assert float(family.weight(t, gamma)) == 0.0
        assert float(family.ratio(t, gamma)) == 1e-3


@pytest.mark.parametrize("gamma", [0.25, 0.8])
def test_hyperbolic_is_mazurs_curve(gamma):
    weights, _ = both(Hyperbolic(), gamma)
    k = 1.0 / gamma - 1.0
    np.testing.assert_allclose(weights, 1.0 / (1.0 + k * np.arange(1, 7)), rtol=1e-12)
    assert weights[0] == pytest.approx(gamma)


def test_hyperbolic_one_discounts_nothing():
    weights, ratios = both(Hyperbolic(), 1.0)
    np.testing.assert_array_equal(weights, np.ones(6))
    np.testing.assert_array_equal(ratios, np.ones(6))


def test_custom_weight_is_the_exponential_of_the_given_logarithm():
    weights, _ = both(CustomDiscounting(quasi_hyperbolic), 0.9)
    expected = 0.9 ** np.arange(1, 7) * np.where(np.arange(1, 7) > 1, 0.7, 1.0)
    np.testing.assert_allclose(weights, expected, rtol=1e-12)
