"""Stage costs against their formulas written out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.games import (
    Composite,
    Effort,
    Goal,
    Lane,
    LaneCenter,
    SigmoidProximity,
    SquaredDistanceHinge,
    TargetSpeed,
)

X = tuple(
    np.array(s) for s in ([0.2, -0.1, 1.5, 0.3], [0.9, 0.4, 0.1, 0.2], [0.1, 0.3, -0.4, 0.6, 7.0])
)
U = (np.array([0.7, -1.2]), np.array([0.3]), np.array([0.1, 0.2, 0.3]))
THETA = {
    "goal": np.array([2.0, 1.0]),
    "target": np.array([-1.0, 0.5]),
    "w": np.array(3.0),
    "d": np.array(1.1),
    "v": np.array(0.9),
}


def value(cost, i=0, x=X, u=U, theta=THETA):
    with jax.enable_x64(True):
        return float(cost(i, 1, tuple(map(jnp.asarray, x)), tuple(map(jnp.asarray, u)), theta))


def gap(i, j):
    return np.linalg.norm(X[i][:2] - X[j][:2])


@pytest.mark.parametrize("i", [0, 1, 2])
@pytest.mark.parametrize(("weight", "number"), [(2.5, 2.5), ("w", 3.0)])
def test_formulas(i, weight, number):
    p = X[i][:2]
    others = [j for j in range(3) if j != i]
    expected = {
        Goal(weight): number * ((p[0] - 2.0) ** 2 + (p[1] - 1.0) ** 2),
        Goal(weight, "target"): number * ((p[0] + 1.0) ** 2 + (p[1] - 0.5) ** 2),
        Effort(weight): number * sum(c * c for c in U[i]),
        SquaredDistanceHinge(1.0, weight): number
        * sum(max(0.0, 1.0 - gap(i, j)) ** 2 for j in others),
        SquaredDistanceHinge("d", weight): number
        * sum(max(0.0, 1.1 - gap(i, j)) ** 2 for j in others),
        SigmoidProximity("d", weight, 4.0): number
        * sum(1.0 / (1.0 + np.exp(4.0 * (gap(i, j) - 1.1))) for j in others),
        SigmoidProximity(1.0, weight, 10.0, (1,)): number
        * sum(1.0 / (1.0 + np.exp(10.0 * (gap(i, j) - 1.0))) for j in others if j == 1),
        LaneCenter(Lane((2.0, -1.0, 0.5)), weight): number
        * (p[1] - (2.0 * p[0] ** 2 - p[0] + 0.5)) ** 2
        / (1.0 + (4.0 * p[0] - 1.0) ** 2),
        TargetSpeed("v", weight): number * (X[i][2] - 0.9) ** 2,
        TargetSpeed(1.4, weight): number * (X[i][2] - 1.4) ** 2,
    }
    for cost, number_expected in expected.items():
        assert value(cost, i) == pytest.approx(number_expected, rel=1e-12), cost


@pytest.mark.parametrize(
    "cost",
    [SquaredDistanceHinge("d", "w"), LaneCenter(Lane((0.3, 0.1)), "w")],
    ids=["hinge", "lane"],
)
def test_composite_is_outer_of_inner_and_outer_is_convex(cost):
    assert isinstance(cost, Composite)
    x, u = tuple(map(jnp.asarray, X)), tuple(map(jnp.asarray, U))
    with jax.enable_x64(True):
        inner = cost.residual(0, 1, x, u, THETA)
        assert value(cost) == pytest.approx(float(cost.loss(inner, THETA)), rel=1e-6)
        random = np.random.default_rng(0)
        for a, b in random.normal(size=(40, 2, inner.shape[0])):
            middle = cost.loss(jnp.asarray(0.5 * (a + b)), THETA)
            ends = [cost.loss(jnp.asarray(v), THETA) for v in (a, b)]
            assert float(middle) <= 0.5 * float(ends[0] + ends[1]) + 1e-12


@pytest.mark.parametrize("cost", [SquaredDistanceHinge(1.2), SigmoidProximity(1.2)])
def test_derivatives_are_finite_when_agents_coincide(cost):
    with jax.enable_x64(True):
        here = jnp.array([1.0, 1.0])

        def at(p):
            return cost(0, 1, (p, here), (here, here), {})

        assert bool(jnp.all(jnp.isfinite(jax.grad(at)(here))))
        assert float(at(here)) >= float(at(here + 0.1))


def test_nobody_near_costs_nothing():
    far = (np.zeros(2), np.array([50.0, 0.0]))
    assert value(SquaredDistanceHinge(1.2), 0, far, far) == 0.0
    assert value(SigmoidProximity(1.0, others=()), 0, far, far) == 0.0
