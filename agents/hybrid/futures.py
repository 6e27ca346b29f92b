"""From proposals to joint futures: every one becomes an equilibrium of the game between agents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from agents.hybrid.network import HYPOTHESES, ProposalNetwork, Proposals, ranked, traits_of
from agents.hybrid.scene import Scene
from agents.hybrid.smooth_game import Basis, SmoothGame, Traits, equilibrium
from agents.hybrid.strategies import GAME_BASIS, HORIZON
from agents.hybrid.window import Explained, explained

EVIDENCE_STEP = 3.0
"""Largest part that the window's evidence has in a future's logarithmic probability."""
LEAST_DEVIATION = 0.03
"""m; no future is more certain."""
GROWTH = (1.0, 1.7)
"""Powers of time that deviations grow by."""


@dataclass(frozen=True)
class GameUse:
    """Use of a network's proposals: with or without a game, inference and the window."""

    game: bool = True
    """Whether proposals become equilibria; else they are the forecast."""
    infer: bool = True
    """Whether discount factors are inferred; else they are 1."""
    window: bool = True
    """Whether the window's likelihood corrects traits and weights futures."""


class JointFutures(NamedTuple):
    """M joint futures of A agents; the first is the central one."""

    strategy: Float[Array, "M A B 2"]
    """Of the game's basis."""
    preferred: Float[Array, "M A B 2"]
    """Without the others."""
    spread: Float[Array, "M A spread"]
    logits: Float[Array, "M"]
    """Logarithmic probabilities."""
    own: Float[Array, "M A"]
    """Of each agent's own futures, without the window's evidence."""
    solved: Bool[Array, "M"]
    traits: Traits
    """(H, A) each."""
    trait_deviation: Float[Array, "H A 4"]
    """Of the numbers that they are made of."""
    hypotheses: Float[Array, "H"]
    """Probabilities of the sets of traits."""


def joint_futures(network: ProposalNetwork, scene: Scene, use: GameUse) -> JointFutures:
    """Return a scene's futures.

    Where a game is not solved the proposal is the future (`JointFutures.solved`).
    """
    return play(network(scene), scene, use)


def play(proposed: Proposals, scene: Scene, use: GameUse) -> JointFutures:
    """Return the futures that a game makes of proposals."""
    there = jnp.asarray(scene.bodies.there)
    proposals, logits = ranked(proposed, there)
    numbers = proposals.traits
    said = Explained(numbers, jnp.ones_like(numbers), jnp.zeros(HYPOTHESES))
    if use.game and use.window:
        said = jax.vmap(lambda n: explained(scene, n, proposals.noise, use.infer))(numbers)
    count = len(logits)
    of_future = jnp.arange(count) % HYPOTHESES
    evidence = said.evidence - jax.nn.logsumexp(said.evidence) + jnp.log(float(HYPOTHESES))
    evidence = jnp.clip(jnp.nan_to_num(evidence), -EVIDENCE_STEP, EVIDENCE_STEP)
    # The central future stays the most likely one.
    weighted = (logits + evidence[of_future]).at[0].set(jnp.max(logits + evidence[of_future]))
    traits = traits_of(said.numbers, use.infer)
    strategy, solved = proposals.preferred, jnp.ones(count, dtype=bool)
    if use.game:
        mine = jax.tree.map(lambda v: v[of_future], traits)

        def solve(preferred: Array, trait: Traits) -> tuple[Array, Array]:
            game = SmoothGame(scene.frames, scene.bodies, trait, preferred)
            return equilibrium(game, GAME_BASIS)

        strategy, solved = jax.vmap(solve)(proposals.preferred, mine)
    return JointFutures(
        strategy,
        proposals.preferred,
        proposals.spread,
        jax.nn.log_softmax(weighted),
        proposals.logits,
        solved,
        traits,
        said.deviation,
        jax.nn.softmax(evidence),
    )


def deviations(spread: Float[Array, "*batch spread"], basis: Basis) -> Float[Array, "*batch T 2"]:
    """Return standard deviations along and across an agent's axes at the basis' times, m."""
    part = basis.times[:, None] / HORIZON
    slow, fast = spread[..., None, :2], spread[..., None, 2:]
    return LEAST_DEVIATION + slow * part ** GROWTH[0] + fast * part ** GROWTH[1]
