"""Start of a solve: cold, from controls, or from the solution of a similar game."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import (
    Parts,
    distances_to_bounds,
    join,
    pairs_of,
    split,
)
from foresight_env.equilibrium.conditions.rollout import rollout
from foresight_env.equilibrium.newton.schedule import Limits, schedule_place
from foresight_env.equilibrium.settings import CentralPath, SolverOptions
from foresight_env.games.types import AnyArray, Scalar


class Start(NamedTuple):
    """Start of a solve."""

    point: Iterate
    warm: Bool[AnyArray, ""] | None = None
    """Whether the point solves a similar game, so that the semismooth phase comes first. None: it
    does not, and the compiled program has no semismooth phase."""
    barrier: Scalar | None = None
    """Complementarity product at which to stop; None: that of `SolverOptions`."""
    limits: Limits | None = None
    """Limits of phases and steps; None: those of `SolverOptions`."""


def on_central_path(
    layout: Layout,
    path: CentralPath,
    parameters: Parameters,
    x: Array,
    u: Array,
    barrier: Scalar,
) -> Iterate:
    """Positive slacks and multipliers around a trajectory, their products equal to `barrier`.

    `path.least_slack` and `path.most_share` limit them.
    """
    pairs = pairs_of(layout)
    exists = split(layout, pairs.exists)
    w = jnp.concatenate([x, u], axis=1)
    penalty = layout.penalties(parameters.theta).astype(x.dtype)
    stages = jnp.arange(1, layout.game.horizon + 1)
    values = jax.vmap(lambda t, v: layout.constraint_values(t, v, parameters.theta))(stages, w)

    def pair(gap: Array, mask: Array) -> tuple[Array, Array]:
        slack = jnp.where(mask, jnp.maximum(gap, path.least_slack), 1.0)
        return slack, jnp.where(mask, barrier / slack, 0.0)

    above, below = distances_to_bounds(layout, pairs, w)
    slack_low, mult_low = pair(above, exists.low)
    slack_high, mult_high = pair(below, exists.high)
    slack, mult = pair(values, exists.row)
    mult = jnp.where(pairs.elastic, jnp.minimum(mult, path.most_share * penalty), mult)
    spare = jnp.where(exists.excess, penalty - mult, 0.0)
    excess = jnp.where(exists.excess, barrier / jnp.where(exists.excess, spare, 1.0), 1.0)
    return Iterate(
        x,
        u,
        join(Parts(slack_low, slack_high, excess, slack)),
        join(Parts(mult_low, mult_high, spare, mult)),
    )


def from_controls(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    u: Float[AnyArray, "T m"],
    place: Int[Array, ""] | int = 1,
) -> Iterate:
    """The trajectory of these controls, far from all bounds of multipliers."""
    u = jnp.asarray(u)
    x = rollout(layout, parameters.initial_state, u)
    barrier = jnp.asarray(options.barrier_schedule)[place - 1]
    return on_central_path(layout, options.path, parameters, x, u, barrier)


def backed_off(
    layout: Layout, options: SolverOptions, parameters: Parameters, point: Iterate
) -> Iterate:
    """A solution's trajectory and multipliers, moved off the boundary."""
    barrier, margin = options.warm_barrier, options.path.warm_margin
    pairs = pairs_of(layout)
    penalty = layout.penalties(parameters.theta).astype(point.x.dtype)
    floor = np.sqrt(barrier)
    slack = jnp.where(
        pairs.exists,
        jnp.maximum(point.slack, barrier / jnp.maximum(point.mult, floor)),
        1.0,
    )
    mult = split(layout, jnp.where(pairs.exists, jnp.maximum(point.mult, barrier / slack), 0))
    slacks = split(layout, slack)
    row = jnp.where(
        pairs.elastic, jnp.clip(mult.row, margin * penalty, (1.0 - margin) * penalty), mult.row
    )
    row = jnp.where(pairs.equality, split(layout, point.mult).row, row)
    spare = jnp.where(pairs.elastic, penalty - row, 0.0)
    excess = jnp.where(
        pairs.elastic,
        jnp.maximum(slacks.excess, barrier / jnp.where(pairs.elastic, spare, 1.0)),
        1.0,
    )
    return Iterate(
        point.x,
        point.u,
        join(slacks._replace(excess=excess)),
        join(mult._replace(excess=spare, row=row)),
    )


def adapted(layout: Layout, parameters: Parameters, point: Iterate) -> Iterate:
    """Another game's solution with this game's pairs and penalties.

    Multipliers of pairs that do not exist here must go: nothing would ever change them.
    """
    pairs = pairs_of(layout)
    slack = jnp.where(pairs.exists, point.slack, 1.0)
    mult = split(layout, jnp.where(pairs.exists, point.mult, 0.0))
    row = jnp.where(pairs.equality, split(layout, point.mult).row, mult.row)
    penalty = layout.penalties(parameters.theta).astype(point.x.dtype)
    spare = jnp.where(pairs.elastic, penalty - row, 0.0)
    return point._replace(slack=slack, mult=join(mult._replace(excess=spare, row=row)))


def begin_phase(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    start: Start,
    number: Int[Array, ""],
) -> Iterate:
    """Return the point at which the phase with this number begins.

    0: a similar game's solution; 1: the path from there, or from the start; from 2 on: the path
    from perturbed controls, away from any symmetry: those of a similar game's solution for
    `warm_phases`, then zeros.
    """

    def near() -> Iterate:
        return adapted(layout, parameters, start.point)

    def first() -> Iterate:
        solves = start.warm
        if solves is None:
            return start.point
        backed = backed_off(layout, options, parameters, start.point)
        return jax.tree.map(lambda a, b: jnp.where(solves, a, b), backed, start.point)

    def perturbed() -> Iterate:
        # Incommensurable frequencies: no two agents are perturbed equally, and runs repeat exactly.
        u = start.point.u
        if start.warm is not None:
            u = jnp.where(start.warm & (number > options.warm_phases), 0.0, u)
        phase = jnp.arange(u.size, dtype=u.dtype).reshape(u.shape)
        shifted = u + options.perturbation * (number - 1) * jnp.sin(1.0 + 2.4 * phase)
        place = schedule_place(options, number, start.warm)
        return from_controls(layout, options, parameters, shifted, place)

    choices = (first, perturbed) if start.warm is None else (near, first, perturbed)
    place = number - (start.warm is None)
    return jax.lax.switch(jnp.clip(place, 0, len(choices) - 1), choices)


def begin(
    layout: Layout, options: SolverOptions, parameters: Parameters, start: Iterate | AnyArray | None
) -> Start:
    """A start from nothing (None: zero controls), controls (T, m), or a similar game's iterate."""
    if isinstance(start, Iterate):
        return Start(start, jnp.ones((), bool))
    u = jnp.zeros((layout.game.horizon, layout.m)) if start is None else start
    return Start(from_controls(layout, options, parameters, u))
