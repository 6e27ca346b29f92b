"""Other scenes that are as true: mirrored, larger or smaller, with shorter tracks."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, PRNGKeyArray

from agents.hybrid.loss import Example
from agents.hybrid.scene import ROUTE_POINTS
from agents.learned.features import KNOWN

LARGEST = 0.25
"""Of the logarithm of a factor of all lengths."""
SHORTER = 0.3
"""Share of scenes of which the beginning is left out."""
LEAST_KNOWN = 2
"""Steps that are kept of those."""


def augmented(example: Example, key: PRNGKeyArray) -> Example:
    """Return the example mirrored or not, scaled, and perhaps with a later beginning.

    Bodies keep their size. A scene of which the beginning is left out has no window for the game.
    """
    sides, sizes, cuts, starts = jax.random.split(key, 4)
    mirror = jnp.where(jax.random.bernoulli(sides), 1.0, -1.0)
    size = jnp.exp(jax.random.uniform(sizes, minval=-LARGEST, maxval=LARGEST))
    short = jax.random.bernoulli(cuts, SHORTER)
    begin = jnp.where(short, jax.random.randint(starts, (), 1, KNOWN - LEAST_KNOWN + 1), 0)
    scene = example.scene
    across = jnp.stack([size, size * mirror])
    past: Any = scene.seen.past * jnp.concatenate([across, across, jnp.ones(1)])
    past = jnp.where((jnp.arange(KNOWN) < begin)[None, :, None], 0.0, past)
    seen = scene.seen._replace(
        past=past,
        kind=scene.seen.kind * jnp.stack([jnp.ones(()), size]),
        others=scene.seen.others
        * jnp.concatenate([across, across, jnp.stack([jnp.ones(()), mirror])]),
    )
    routes = scene.routes * jnp.concatenate([jnp.tile(across, len(ROUTE_POINTS)), jnp.ones(1)])
    frames = scene.frames._replace(
        place=scene.frames.place * across,
        velocity=scene.frames.velocity * across,
        rotation=_mirrored(jnp.asarray(scene.frames.rotation), mirror),
    )
    start = scene.start._replace(
        place=scene.start.place * across,
        velocity=scene.start.velocity * across,
        rotation=frames.rotation,
    )
    changed = scene._replace(
        seen=seen,
        routes=routes,
        kinematic=scene.kinematic * across,
        roughness=scene.roughness * size,
        frames=frames,
        start=start,
        window=scene.window * across,
        followed=scene.followed & (begin == 0),
    )
    return example._replace(scene=changed, target=example.target * across)


def _mirrored(rotation: Array, mirror: Array) -> Array:
    """Axes in the mirror `y -> mirror y`, still a rotation: both other entries change sign."""
    return rotation * jnp.stack(
        [jnp.stack([jnp.ones(()), mirror]), jnp.stack([mirror, jnp.ones(())])]
    )
