"""Equilibria that are known without the solver: linear-quadratic games, constructed KKT points."""

from dataclasses import dataclass
from functools import lru_cache

import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import Status, solve
from foresight_env.games import (
    Bounds,
    Equality,
    Exponential,
    Game,
    Hyperbolic,
    Inequality,
    Player,
    SharedInequality,
)
from tests.support.small_games import Linear, Quadratic

HORIZON = 6
STATE_SIZES, CONTROL_SIZES = (2, 3), (2, 2)
N, M = sum(STATE_SIZES), sum(CONTROL_SIZES)
OWN = [
    np.r_[0:2, N : N + 2],  # the first player's entries of w = (x1, x2, u1, u2)
    np.r_[2:5, N + 2 : N + 4],
]
STATES = [slice(0, 2), slice(2, 5)]
CONTROLS = [slice(N, N + 2), slice(N + 2, N + 4)]


def matrices():
    """Random stable dynamics, the same for all tests."""
    random = np.random.default_rng(5)
    a = [np.eye(n) + 0.3 * random.normal(size=(n, n)) for n in STATE_SIZES]
    b = [random.normal(size=(n, m)) for n, m in zip(STATE_SIZES, CONTROL_SIZES, strict=True)]
    return a, b


@lru_cache
def quadratic_game(discountings=(Exponential(), Exponential())):
    a, b = matrices()
    players = tuple(
        Player(Linear.of(a[i], b[i]), (Quadratic(),), discounting=discountings[i]) for i in range(2)
    )
    return Game(players, HORIZON)


def random_costs(random, coupling=0.3):
    """Per player and stage a convex quadratic in its own entries, coupled to the other's."""
    costs = []
    for i in range(2):
        q = np.zeros((HORIZON, N + M, N + M))
        for t in range(HORIZON):
            full = coupling * random.normal(size=(N + M, N + M))
            q[t] = 0.5 * (full + full.T)
            root = random.normal(size=(len(OWN[i]), len(OWN[i])))
            q[t][np.ix_(OWN[i], OWN[i])] = 0.2 * root @ root.T + np.eye(len(OWN[i]))
        costs.append({"Q": q, "c": random.normal(size=(HORIZON, N + M))})
    return tuple(costs)


def open_loop_nash(initial_state, theta, weights):
    """States (T, n) and controls (T, m) from the players' stacked linear KKT system.

    Plain Lagrangians with absolute weights `Gamma^i(t)` and multipliers of the dynamics, solved
    densely: nothing in common with the solver but the problem.
    """
    a, b = matrices()
    size = N + M + N  # x_{t+1}, u_t and the dynamics' multipliers p_t
    big, right = np.zeros((HORIZON * size,) * 2), np.zeros(HORIZON * size)
    joint_a = np.block([[a[0], np.zeros((2, 3))], [np.zeros((3, 2)), a[1]]])
    joint_b = np.block([[b[0], np.zeros((2, 2))], [np.zeros((3, 2)), b[1]]])
    for t in range(HORIZON):
        at = t * size
        w, p = slice(at, at + N + M), slice(at + N + M, at + size)
        for i in range(2):
            rows = at + OWN[i]
            big[rows, w] = weights[i][t] * theta[i]["Q"][t][OWN[i]]
            right[rows] = -weights[i][t] * theta[i]["c"][t][OWN[i]]
        big[at : at + N, p] -= np.eye(N)
        big[at + N : at + N + M, p] += joint_b.T
        if t + 1 < HORIZON:
            later = slice(p.start + size, p.stop + size)
            big[at : at + N, later] += joint_a.T
        big[p, at : at + N] = -np.eye(N)
        big[p, at + N : at + N + M] = joint_b
        if t:
            big[p, at - size : at - size + N] = joint_a
        else:
            right[p] = -joint_a @ initial_state
    stages = np.linalg.solve(big, right).reshape(HORIZON, size)
    return stages[:, :N], stages[:, N : N + M]


@pytest.mark.parametrize("gamma", [(0.9, 0.6), (1.0, 1.0), (0.3, 1.1), (1.1, 0.95)])
@pytest.mark.parametrize("seed", [0, 1])
def test_linear_quadratic_games_have_their_closed_form(gamma, seed):
    random = np.random.default_rng(seed)
    theta, initial_state = random_costs(random), random.normal(size=N)
    weights = [g ** np.arange(1, HORIZON + 1) for g in gamma]
    x, u = open_loop_nash(initial_state, theta, weights)
    found = solve(quadratic_game(), (initial_state[:2], initial_state[2:]), theta, gamma)
    assert found.status == Status.SOLVED
    np.testing.assert_allclose(np.concatenate(found.states, 1)[1:], x, atol=1e-6)
    np.testing.assert_allclose(np.concatenate(found.controls, 1), u, atol=1e-6)


def test_every_player_discounts_in_its_own_way():
    random = np.random.default_rng(3)
    theta, initial_state = random_costs(random), random.normal(size=N)
    t = np.arange(1, HORIZON + 1)
    weights = [1.0 / (1.0 + (1.0 / 0.4 - 1.0) * t), 0.8**t]
    x, _ = open_loop_nash(initial_state, theta, weights)
    game = quadratic_game((Hyperbolic(), Exponential()))
    found = solve(game, (initial_state[:2], initial_state[2:]), theta, (0.4, 0.8))
    assert found.status == Status.SOLVED
    np.testing.assert_allclose(np.concatenate(found.states, 1)[1:], x, atol=1e-6)


@dataclass(frozen=True)
class Rows:
    """`G_t w + h_t` from theta (the first player's when shared)."""

    name: str

    def __call__(self, *arguments):
        t, x, u, theta = arguments[-4:]
        own = theta if isinstance(theta, dict) else theta[0]
        w = jnp.concatenate([*x, *u])
        return own[f"{self.name} G"][t - 1] @ w + own[f"{self.name} h"][t - 1]


PRICE = 1.5
CONTROL_LIMIT = 1.0


@lru_cache
def constrained_game(multiplier):
    """Every kind of constraint at once; the second player has no equality."""
    a, b = matrices()
    players = tuple(
        Player(
            Linear.of(a[i], b[i]),
            (Quadratic(),),
            control_bounds=Bounds.box(-CONTROL_LIMIT, CONTROL_LIMIT, CONTROL_SIZES[i]),
            inequalities=(Inequality(Rows("hard"), 1), Inequality(Rows("elastic"), 2, "price")),
            equalities=(Equality(Rows("equal"), 1),) if i == 0 else (),
        )
        for i in range(2)
    )
    return Game(players, HORIZON, (SharedInequality(Rows("shared"), 1, multiplier),))


def choose_active(random):
    """Which constraints hold with equality at each stage: at most as many as a player's controls.

    Keys: `shared` (T, 1); per player `bound` (T, 2), `hard` (T, 1), `edge` (T, 2).
    """
    shared = random.random((HORIZON, 1)) < 0.5
    shared[0] = True
    own = []
    for i in range(2):
        flags = np.zeros((HORIZON, 5), bool)
        for t in range(HORIZON):
            room = 2 - shared[t, 0] - (i == 0)
            chosen = random.permutation(5)[: random.integers(0, room + 1)]
            flags[t, chosen] = True
        own.append({"bound": flags[:, :2], "hard": flags[:, 2:3], "edge": flags[:, 3:]})
    return shared, own


def row(random, count, i):
    """(T, count, n + m) normals that mostly concern player `i`."""
    g = 0.05 * random.normal(size=(HORIZON, count, N + M))
    g[:, :, OWN[i]] += random.normal(size=(HORIZON, count, len(OWN[i])))
    return g


def known_point(multiplier, gamma, random):
    """A game built around a chosen trajectory and chosen multipliers, all strictly complementary.

    With the costates chosen too, the players' first-order conditions give the linear cost terms.
    """
    a, b = matrices()
    shared_active, active = choose_active(random)
    initial_state = random.normal(size=N)
    u = random.uniform(-0.8, 0.8, (HORIZON, M))
    at_limit = np.concatenate([active[0]["bound"], active[1]["bound"]], 1)
    u = np.where(at_limit, np.sign(u) * CONTROL_LIMIT, u)
    x, before = np.zeros((HORIZON, N)), initial_state
    for t in range(HORIZON):
        for i in range(2):
            control = u[t, CONTROLS[i].start - N : CONTROLS[i].stop - N]
            x[t, STATES[i]] = a[i] @ before[STATES[i]] + b[i] @ control
        before = x[t]
    w = np.concatenate([x, u], 1)
    theta = random_costs(random, coupling=0.05)
    # `pull`: multipliers times d g / d w, entry by entry in the owner's current value.
    pull = np.zeros((HORIZON, N + M))
    pull[:, N:] -= at_limit * np.sign(u) * random.uniform(0.5, 1.5, (HORIZON, M))

    def add(i, name, value, mult, g):
        owner = theta[max(i, 0)]
        owner[f"{name} G"], owner[f"{name} h"] = g, value - np.einsum("tka,ta->tk", g, w)
        for j in range(2) if i < 0 else [i]:
            share = mult
            if i < 0 and multiplier == "common":  # the same Gamma^j lambda^j for both
                share = mult * (weights.min(axis=1) / weights[:, j])[:, None]
            pull[:, OWN[j]] += np.einsum("tk,tka->ta", share, g)[:, OWN[j]]

    weights = np.array(gamma) ** np.arange(1, HORIZON + 1)[:, None]
    for i in range(2):
        theta[i]["price"] = PRICE
        amount = random.uniform(0.4, 1.0, (HORIZON, 6))
        on = active[i]["hard"]
        add(i, "hard", np.where(on, 0, amount[:, :1]), on * amount[:, :1], row(random, 1, i))
        edge, paid = active[i]["edge"], random.random((HORIZON, 2)) < 0.3
        room = amount[:, 1:3]
        value = np.where(edge, 0.0, np.where(paid, -room, room))
        mult = np.where(edge, room, np.where(paid, PRICE, 0.0))
        add(i, "elastic", value, mult, row(random, 2, i))
        if i == 0:
            zero = np.zeros((HORIZON, 1))
            add(i, "equal", zero, amount[:, 3:4] - 0.7, row(random, 1, i))
    amount = random.uniform(0.5, 1.0, (HORIZON, 1))
    both = row(random, 1, 0) + row(random, 1, 1)
    add(-1, "shared", np.where(shared_active, 0.0, amount), shared_active * amount, both)
    for i in range(2):
        q = random.normal(size=(HORIZON + 1, STATE_SIZES[i]))
        q[HORIZON] = 0.0
        rest = np.einsum("tab,tb->ta", theta[i]["Q"], w) - pull
        for t in range(HORIZON):
            sx, su = STATES[i], CONTROLS[i]
            theta[i]["c"][t, sx] = q[t] - gamma[i] * a[i].T @ q[t + 1] - rest[t, sx]
            theta[i]["c"][t, su] = -b[i].T @ q[t] - rest[t, su]
    return initial_state, theta, x, u


@pytest.mark.parametrize("multiplier", ["individual", "common"])
@pytest.mark.parametrize("seed", range(4))
def test_a_constructed_equilibrium_is_found(multiplier, seed):
    gamma = (0.9, 0.6)
    initial_state, theta, x, u = known_point(multiplier, gamma, np.random.default_rng(seed))
    found = solve(
        constrained_game(multiplier), (initial_state[:2], initial_state[2:]), theta, gamma
    )
    assert found.status == Status.SOLVED
    np.testing.assert_allclose(np.concatenate(found.controls, 1), u, atol=1e-6)
    np.testing.assert_allclose(np.concatenate(found.states, 1)[1:], x, atol=1e-6)
