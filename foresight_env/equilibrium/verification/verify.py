"""Test whether a first-order point is a local Nash equilibrium, player by player.

Two tests per player: its curvature on the subspace that active constraints leave free (second-order
sufficient condition, Nocedal and Wright, theorem 12.6), and the gap to its best response, found by
re-optimising that player alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foresight_env.annotations import no_type_check
from foresight_env.compilation import compiled
from foresight_env.equilibrium.checks.validation import check_kinds, check_parameters
from foresight_env.equilibrium.conditions.curvature import dynamics_hessian
from foresight_env.equilibrium.conditions.kkt import (
    Iterate,
    Parameters,
    discount_ratios,
    row_shares,
)
from foresight_env.equilibrium.conditions.layout import Layout, layout_of
from foresight_env.equilibrium.conditions.pairs import Parts, join, pairs_of, split
from foresight_env.equilibrium.conditions.residual import evaluate
from foresight_env.equilibrium.newton.implicit import equilibrium
from foresight_env.equilibrium.newton.start import Start, begin
from foresight_env.equilibrium.settings import SolverOptions, VerificationSettings
from foresight_env.equilibrium.solve import Solution
from foresight_env.equilibrium.status import Status
from foresight_env.equilibrium.verification.best_response import (
    best_response_game,
    best_response_theta,
    same_best_response,
)
from foresight_env.games.game import Game
from foresight_env.games.stage import stage_cost
from foresight_env.games.types import AnyArray, Scalar, Theta
from foresight_env.precision import to_double, to_numpy


class Verification(NamedTuple):
    """Result of `verify`; arrays have one entry per player."""

    is_local_equilibrium: Bool[AnyArray, ""]
    """Solved, curvature positive, and no local improvement beyond a millionth of the cost."""
    gap: Float[AnyArray, "N"]
    """Cost minus that of the best response found from the equilibrium itself (a local search), both
    in current value at the first stage; at most rounding when no player can improve, NaN where that
    search failed. It does not reveal a saddle, to which the local search may return: `curvature`
    does."""
    cold_gap: Float[AnyArray, "N"]
    """The same from a cold start: positive when another local optimum (say, passing on the other
    side) would be better. NaN where that search failed."""
    curvature: Float[AnyArray, "N"]
    """Smallest eigenvalue of the player's Lagrangian Hessian on the free subspace, stages scaled to
    current value. Negative: a saddle, not a local equilibrium."""


def player_cost(
    layout: Layout, i: int, x: Float[Array, "T n"], u: Float[Array, "T m"], parameters: Parameters
) -> Scalar:
    """Player i's cost in current value at stage 1, `J^i / Gamma^i(1)`, with elastic penalties."""
    ratios = discount_ratios(layout, parameters.gamma)[:, i]
    weight = jnp.concatenate([jnp.ones(1), jnp.cumprod(ratios[1:])])

    def stage(t: Array, xt: Array, ut: Array) -> tuple[Scalar, Scalar]:
        xs, us = layout.split_states(xt), layout.split_controls(ut)
        return stage_cost(layout.game, i, t, xs, us, parameters.theta[i])

    discounted, flat = jax.vmap(stage)(jnp.arange(1, layout.game.horizon + 1), x, u)
    return jnp.sum(weight * discounted) + jnp.sum(flat) / ratios[0]


def _reduced_hessian(
    layout: Layout,
    options: SolverOptions,
    settings: VerificationSettings,
    parameters: Parameters,
    point: Iterate,
) -> Float[Array, "k k"]:
    """Second derivatives of a one-player game's Lagrangian by all controls (k = T m).

    States follow from controls, active constraints are stiff, stages are scaled to current value.
    """
    pairs, exact = pairs_of(layout), jnp.zeros(())
    ev = evaluate(layout, pairs, point, parameters, exact, options.barrier)
    lin, n, m, horizon = ev.lin, layout.n, layout.m, layout.game.horizon
    curve = dynamics_hessian(layout, ev.lin.previous, point.u, ev.q)

    # Columns: all controls, each scaled by Gamma(t)^(-1/2); rows: states scaled by Gamma(t)^(1/2).
    def step(carry: Array, s: Any) -> tuple[Array, tuple[Array, Array]]:
        t, a, b, rho = s
        before = jnp.sqrt(rho)[:, None] * carry
        own = jnp.eye(horizon * m)[t * m + jnp.arange(m)]
        after = a @ before + b @ own
        return after, (jnp.concatenate([after, own]), jnp.concatenate([before, own]))

    zero = jnp.zeros((n, horizon * m))
    stages = jnp.arange(horizon)
    _, (at_next, at_now) = jax.lax.scan(step, zero, (stages, lin.a, lin.b, lin.rho))
    hessian = jnp.einsum("tak,tab,tbl->kl", at_next, lin.hessian, at_next)
    if curve is not None:
        hessian += jnp.einsum("tak,tab,tbl->kl", at_now, curve, at_now)
    stiff = settings.stiffness * jnp.maximum(jnp.max(jnp.abs(hessian)), 1.0)

    active = split(layout, pairs.exists & (point.mult > point.slack))
    bounds = jnp.where(active.low, stiff, 0.0) + jnp.where(active.high, stiff, 0.0)
    hessian += jnp.einsum("tak,ta,tal->kl", at_next, bounds, at_next)
    # An elastic row holds like a hard one until its whole penalty is paid.
    whole = pairs.elastic & ~active.excess
    held = (active.row & ~whole) | pairs.equality
    rows = jnp.where(held, stiff, 0.0)
    normals = jnp.einsum("tka,tal->tkl", lin.jacobian, at_next)
    hessian += jnp.einsum("tkl,tk,tkj->lj", normals, rows, normals)
    return 0.5 * (hessian + hessian.T)


def _least_eigenvalue(matrix: Float[np.ndarray, "k k"]) -> float:
    # NumPy's: jaxlib 0.10 fails to compile its own on machines with one core.
    return float(np.linalg.eigvalsh(matrix)[0]) if np.isfinite(matrix).all() else np.nan


def restricted(layout: Layout, i: int, point: Iterate, parameters: Parameters) -> Iterate:
    """Player i's part of a joint iterate, in the layout of its best-response game."""
    share = row_shares(layout, discount_ratios(layout, parameters.gamma))
    mine = layout.owner == i
    rows = [k for k, r in enumerate(layout.rows) if r.binds[i] and r.kind != "equality"]
    private = [k for k in rows if layout.rows[k].player == i]
    equal = [k for k, r in enumerate(layout.rows) if r.player == i and r.kind == "equality"]
    shared = [k for k in rows if layout.rows[k].player == -1]
    order = jnp.asarray([*private, *shared, *equal], int)
    sx, su = layout.state_slices[i], layout.control_slices[i]

    def own(values: Array) -> Array:
        parts = split(layout, values)
        bounds, of_rows = (p[:, mine] for p in parts[:2]), (p[:, order] for p in parts[2:])
        return join(Parts(*bounds, *of_rows))

    mult = split(layout, point.mult)
    felt = mult._replace(row=mult.row * share[:, :, sx.start])
    return Iterate(point.x[:, sx], point.u[:, su], own(point.slack), own(join(felt)))


class _Checked(NamedTuple):
    """Results of one player."""

    gap: Scalar
    cold_gap: Scalar
    hessian: Float[Array, "k k"]
    cost: Scalar


def _checked(
    alone: Layout,
    options: SolverOptions,
    settings: VerificationSettings,
    parameters: Parameters,
    own: Iterate,
) -> _Checked:
    """Best responses from both starts in a loop, whose body is compiled once."""
    here = player_cost(alone, 0, own.x, own.u, parameters)
    away = jnp.sin(1.0 + jnp.arange(own.u.size)).reshape(own.u.shape)
    perturbed = own._replace(u=own.u + settings.perturbation * away)
    cold = begin(alone, options, parameters, None).point
    points = jax.tree.map(lambda *v: jnp.stack(v), perturbed, cold)

    def gain(start: Start) -> Array:
        found = equilibrium(alone, options, parameters, start)
        cost = player_cost(alone, 0, found.point.x, found.point.u, parameters)
        return jnp.where(found.success, here - cost, jnp.nan)

    gap, cold_gap = jax.lax.map(gain, Start(points, jnp.array([True, False])))
    hessian = _reduced_hessian(alone, options, settings, parameters, own)
    return _Checked(gap, cold_gap, hessian, here)


@compiled(static_argnums=(0, 1, 2))
def _verify(
    layout: Layout,
    options: SolverOptions,
    settings: VerificationSettings,
    parameters: Parameters,
    point: Iterate,
) -> tuple[_Checked, ...]:
    """Best responses and curvature, player by player."""
    found: list[_Checked] = []
    for members in same_best_response(layout.game, parameters.theta):
        alone = layout_of(best_response_game(layout.game, members.start))
        given = []
        for i in members:
            theta = best_response_theta(
                layout, i, parameters.theta, point.x, point.u, place=members.start
            )
            start = parameters.initial_state[layout.state_slices[i]]
            mine = Parameters(start, (theta,), parameters.gamma[i : i + 1])
            given.append((mine, restricted(layout, i, point, parameters)))
        if len(given) == 1:
            found.append(_checked(alone, options, settings, *given[0]))
            continue
        stacked = jax.tree.map(lambda *v: jnp.stack([*map(jnp.asarray, v)]), *given)
        together = jax.lax.map(
            lambda one, alone=alone: _checked(alone, options, settings, *one), stacked
        )
        found += [jax.tree.map(lambda v, k=k: v[k], together) for k in range(len(given))]
    return tuple(found)


@no_type_check
def verify(
    game: Game,
    solution: Solution,
    theta: Sequence[Theta],
    gamma: Any,
    *,
    options: SolverOptions = SolverOptions(),
    settings: VerificationSettings = VerificationSettings(),
) -> Verification:
    """Check that a solution is a local equilibrium: no player gains by deviating alone.

    Second-order conditions, and a best response of every player against the others' solution, from
    the solution itself and from a cold start. The first call of a game compiles.

    Args:
        game: the game that was solved.
        solution: of `solve`, for one game.
        theta: one mapping of cost parameters per player, as given to `solve`.
        gamma: discount factors (N,) or one number, as given to `solve`.
        options: settings of the forward solver.
        settings: settings of the best-response search.

    Returns:
        A `Verification` with the verdict and, per player, gains by deviating and curvature.

    Raises:
        ValueError: an argument has another type, or a shape that does not fit the game.
    """
    check_kinds(
        game=(game, Game),
        solution=(solution, Solution),
        options=(options, SolverOptions),
        settings=(settings, VerificationSettings),
    )
    layout = layout_of(game)
    parameters = check_parameters(game, [s[0] for s in solution.states], theta, gamma)
    with jax.enable_x64(True):
        found = to_numpy(_verify(layout, options, settings, parameters, to_double(solution.point)))
    gap, cold_gap, cost = (
        np.array([getattr(one, name) for one in found]) for name in ("gap", "cold_gap", "cost")
    )
    curvature = np.array([_least_eigenvalue(one.hessian) for one in found])
    rounding = settings.rounding * np.maximum(1.0, np.abs(cost))
    solved = int(solution.status) == Status.SOLVED
    local = solved and bool((curvature > 0.0).all() and (gap <= rounding).all())
    return Verification(np.asarray(local), gap, cold_gap, curvature)
