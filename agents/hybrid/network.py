"""Network that proposes joint futures: preferred motions, traits, deviations, probabilities.

Each agent's track is a token in its own frame; attention between agents, with how two stand to each
other in it (`agents.learned.interaction_transformer`), then one query per future.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from agents.hybrid.scene import ROUTE_POINTS, Scene
from agents.hybrid.smooth_game import Traits
from agents.hybrid.strategies import DEGREE
from agents.learned.features import KNOWN
from agents.learned.interaction_transformer import Block

MODES = 20
"""Joint futures."""
HYPOTHESES = 3
"""Sets of traits; future m has set `m % HYPOTHESES`."""
COEFFICIENTS = 2 * DEGREE
SPREAD = 4
"""Numbers of a deviation: along and across, growing like `t` and like `t^1.7`."""
UNIT = (1.0, 0.5)
"""Coefficients are in units of this many metres, and of this many seconds times the speed."""
LEAST_ROUGHNESS = 1e-3
"""Added to roughness before its logarithm, m: interpolated positions have roughness 0."""


class Proposals(NamedTuple):
    """Of A agents; in every axis of M the first is the central future."""

    preferred: Float[Array, "M A B 2"]
    """Coefficients of preferred motions."""
    spread: Float[Array, "M A spread"]
    """Numbers of deviations, m."""
    logits: Float[Array, "M A"]
    """Of each agent's own futures."""
    traits: Float[Array, "H A 4"]
    """Numbers that traits are made of (`traits_of`)."""
    noise: Float[Array, ""]
    """Standard deviation of observations about the game of the window, m."""


class ProposalNetwork(eqx.Module):
    """From a scene to `Proposals`.

    Proposals are departures from motion with constant turn rate and acceleration, scaled by `keep`.
    """

    embed: eqx.nn.MLP
    route: eqx.nn.MLP
    blocks: tuple[Block, ...]
    query: Float[Array, "M width"]
    anchors: Float[Array, "M coefficients"]
    future: eqx.nn.MLP
    central: eqx.nn.MLP
    keep: eqx.nn.Linear
    trait: eqx.nn.MLP
    noise: Float[Array, ""]
    share: Float[Array, ""]
    """Shrinkage factor in [0, 1] of the central future's departure from kinematic motion; chosen on
    validation data, not trained."""

    def __init__(
        self,
        *,
        key: PRNGKeyArray,
        width: int = 64,
        depth: int = 2,
        heads: int = 4,
        anchors: Float[np.ndarray, "M coefficients"] | None = None,
    ) -> None:
        """`anchors`: coefficients, in units, about which the futures are proposed."""
        keys = jax.random.split(key, 7 + depth)
        make = eqx.nn.MLP
        points = 2 * len(ROUTE_POINTS) + 1
        self.embed = make(
            KNOWN * 5 + 6 + COEFFICIENTS, width, width, 2, activation=jax.nn.gelu, key=keys[0]
        )
        self.route = make(points, width, width, 1, activation=jax.nn.gelu, key=keys[1])
        self.blocks = tuple(Block(width, heads, key=k) for k in keys[7:])
        self.query = 0.5 * jax.random.normal(keys[2], (MODES, width))
        blank = np.zeros((MODES, COEFFICIENTS))
        self.anchors = jnp.asarray(blank if anchors is None else anchors, jnp.float32)
        self.future = make(
            2 * width, COEFFICIENTS + SPREAD + 1, width, 2, activation=jax.nn.gelu, key=keys[3]
        )
        self.central = make(width, COEFFICIENTS, width, 1, activation=jax.nn.gelu, key=keys[4])
        self.trait = make(width, 4 * HYPOTHESES, width, 1, activation=jax.nn.gelu, key=keys[5])
        self.keep = eqx.nn.Linear(width, 1, key=keys[6])
        self.noise = jnp.asarray(-2.0)
        self.share = jnp.asarray(1.0)

    def __call__(self, scene: Scene) -> Proposals:
        """Return proposals; those of empty places mean nothing."""
        seen, bodies = scene.seen, scene.bodies
        count = len(seen.kind)
        size = jnp.stack([bodies.half_length, bodies.half_width], axis=1)
        unit = units(scene)
        kinematic = jnp.asarray(scene.kinematic).reshape(count, -1) / unit[:, None]
        rough = jnp.log(jnp.asarray(scene.roughness) + LEAST_ROUGHNESS)
        past = jnp.reshape(seen.past, (count, -1))
        flat = [past, jnp.asarray(seen.kind), size, kinematic, rough]
        tokens = jax.vmap(self.embed)(jnp.concatenate(flat, axis=1))
        routes = jnp.asarray(scene.routes)
        ways = jax.vmap(jax.vmap(self.route))(routes)
        tokens = tokens + jnp.max(jnp.where(routes[..., -1:] > 0.5, ways, 0.0), axis=1)
        for block in self.blocks:
            tokens = block(tokens, jnp.asarray(seen.others), jnp.asarray(seen.there))
        anchors, share = jax.lax.stop_gradient((self.anchors, self.share))

        def proposed(token: Array, unit: Array, kinematic: Array) -> tuple[Array, Array, Array]:
            raw = jax.vmap(lambda query: self.future(jnp.concatenate([token, query])))(self.query)
            ways = (anchors + raw[:, :COEFFICIENTS]).at[0].set(self.central(token))
            ways = ways + jax.nn.sigmoid(self.keep(token)) * kinematic
            ways = ways.at[0].set(kinematic + share * (ways[0] - kinematic))
            logits = raw[:, -1]
            # The central future is the most likely.
            first = jnp.max(logits[1:]) + jax.nn.softplus(logits[0])
            spread = 0.3 * unit * jax.nn.softplus(raw[:, COEFFICIENTS:-1] - 1.0)
            return unit * ways, spread, logits.at[0].set(first)

        ways, spread, logits = jax.vmap(proposed, out_axes=1)(tokens, unit, kinematic)
        traits = jax.vmap(self.trait)(tokens).reshape(count, HYPOTHESES, 4).swapaxes(0, 1)
        return Proposals(
            ways.reshape(MODES, count, DEGREE, 2),
            spread,
            logits,
            traits + jnp.array(START),
            0.01 + jax.nn.softplus(self.noise),
        )


def units(scene: Scene) -> Float[Array, "A"]:
    """Return the unit of each agent's coefficients, m."""
    return UNIT[0] + UNIT[1] * jnp.asarray(scene.seen.kind)[:, 1]


LEAST_GAMMA = 0.05
"""Per second."""
START = (1.0, -2.0, 3.4, -2.3)
"""Numbers that traits are made of before training: gamma 0.74 per second, effort 0.14 s^4,
conflict 30, margin 0.1 m."""

RANGE = 4.0
"""By how much they may differ from those, so that no trait overflows."""


def traits_of(numbers: Float[Array, "*batch 4"], infer: bool = True) -> Traits:
    """Return traits of numbers: a gamma by a sigmoid, all others by exponentials.

    Discount factors are 1 unless they are inferred.
    """
    start = jnp.array(START)
    a, b, c, d = jnp.moveaxis(jnp.clip(numbers, start - RANGE, start + RANGE), -1, 0)
    gamma = LEAST_GAMMA + (1.0 - LEAST_GAMMA) * jax.nn.sigmoid(a)
    gamma = gamma if infer else jnp.ones_like(gamma)
    return Traits(gamma, jnp.exp(b), jnp.exp(c), jnp.exp(d))


def ranked(proposals: Proposals, there: Bool[Array, "A"]) -> tuple[Proposals, Float[Array, "M"]]:
    """Return proposals in which future m joins every agent's m-th most likely one.

    And the joint futures' logarithmic probabilities: means over agents of those that they have.
    """
    order = jnp.argsort(-proposals.logits, axis=0)

    def sorted_by(values: Array) -> Array:
        index = order.reshape(*order.shape, *(1,) * (values.ndim - 2))
        return jnp.take_along_axis(values, index, axis=0)

    own = jax.nn.log_softmax(sorted_by(proposals.logits), axis=0)
    share = jnp.where(there, 1.0, 0.0) / jnp.maximum(jnp.sum(there), 1)
    joint = jnp.log(jnp.sum(jnp.exp(own) * share, axis=1) + 1e-9)
    found = proposals._replace(
        preferred=sorted_by(proposals.preferred), spread=sorted_by(proposals.spread), logits=own
    )
    return found, joint
