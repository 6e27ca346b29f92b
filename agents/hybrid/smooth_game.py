"""Open-loop Nash equilibria of tracking games between agents with smooth strategies.

Every agent has a preferred motion and pays for leaving it and for coming close to others:

    J_i = sum_t gamma_i^t ( |p_i(t) - p*_i(t)|^2 + effort_i |a_i(t) - a*_i(t)|^2
                            + conflict_i sum_j depth_ij(t)^2 ),

`t` in seconds, `a` the acceleration. Its strategy is a departure from straight motion, a polynomial
of time in the axes of the agent: `p_i(t) = place_i + t velocity_i + R_i Phi(t) z_i`, with
`Phi(0) = Phi'(0) = 0` or `Phi(0) = 0`. An equilibrium is a `z` at which no agent can lower its cost
by another polynomial. As `Phi` is small, thousands of games are solved per second, in batches, and
their derivatives are exact (implicit function theorem). Without conflicts the equilibrium is the
preferred motion itself, whatever the discount factor.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from foresight_env.games.types import AnyArray, Scalar

APPROACH = 6
"""Steps with Newton's matrix without the depths' own curvature, in which no cost is concave."""
FINISH = 4
"""Steps with the whole matrix: they converge quadratically. `benchmarks.hybrid` counts the games
that are not solved after them."""
TOLERANCE = 1e-3
"""Largest gradient of an equilibrium: of squared metres by coefficients in metres."""
REGULARISATION = 1e-4
"""Added to the diagonal of Newton's matrix."""
MOST_RESPONSE = 1e3
"""A game is nearly singular where gradients of 1 change a coefficient by this, m."""
NO_LENGTH = 1e-2
"""Distances are at least this, in units of the ellipse, so that they have derivatives: recordings
have agents twice, on top of each other."""


class Frames(NamedTuple):
    """Places, velocities and axes of A agents at the start of a game."""

    place: Float[AnyArray, "*b A 2"]
    """m."""
    velocity: Float[AnyArray, "*b A 2"]
    """m/s."""
    rotation: Float[AnyArray, "*b A 2 2"]
    """From the agent's own axes to the plane's."""


class Bodies(NamedTuple):
    """Extents of agents."""

    half_length: Float[AnyArray, "*b A"]
    """m; the radius of those who are no vehicles."""
    half_width: Float[AnyArray, "*b A"]
    vehicle: Bool[AnyArray, "*b A"]
    there: Bool[AnyArray, "*b A"]
    """False in empty places: they meet no one."""


class Traits(NamedTuple):
    """Parameters of agents' costs."""

    gamma: Float[Array, "*b A"]
    """Discount factor per second, above 0."""
    effort: Float[Array, "*b A"]
    """Weight of accelerations, s^4."""
    conflict: Float[Array, "*b A"]
    """Weight of others' depth in the room that the agent keeps free."""
    margin: Float[Array, "*b A"]
    """Room kept free in addition to the bodies, m."""


class SmoothGame(NamedTuple):
    """A game; `equilibrium` solves it."""

    frames: Frames
    bodies: Bodies
    traits: Traits
    preferred: Float[Array, "*b A B 2"]
    """Coefficients of preferred motions."""


class Basis(NamedTuple):
    """Functions of time that strategies are combined of, at T steps."""

    times: Float[AnyArray, "T"]
    """s."""
    value: Float[AnyArray, "T B"]
    acceleration: Float[AnyArray, "T B"]
    """Second derivative, 1/s^2."""


def positions(
    frames: Frames, strategy: Float[Array, "A B 2"], basis: Basis
) -> Float[Array, "A T 2"]:
    """Return positions (m) at the steps of the basis."""
    line = frames.place[:, None] + basis.times[:, None] * frames.velocity[:, None]
    away = jnp.einsum("tb,abk->atk", basis.value, strategy)
    return jnp.asarray(line) + jnp.einsum("aik,atk->ati", frames.rotation, away)


class _Room(NamedTuple):
    """The ellipse that each agent i keeps free of each other j, at T steps."""

    axes: Float[Array, "A A T 2 2"]
    """From the plane to the unit circle, 1/m."""
    width: Float[Array, "A A"]
    """Half the minor axis, m; 0 where no one is met."""


def _room(game: SmoothGame, basis: Basis) -> _Room:
    """In the axes of i's preferred motion where i is a vehicle, else of j's; circles for people."""
    bodies, margin = game.bodies, game.traits.margin
    path = positions(game.frames, game.preferred, basis)
    before = jnp.concatenate([game.frames.place[:, None], path[:, :-1]], axis=1)
    way = path - before
    ahead = game.frames.rotation[:, None, :, 0]
    moving = jnp.sum(way**2, axis=-1, keepdims=True) > 1e-4
    way = jnp.where(moving, way, ahead)
    way = way / jnp.sqrt(jnp.sum(way**2, axis=-1, keepdims=True))
    mine = bodies.vehicle[:, None, None, None]
    along = jnp.where(mine, way[:, None], way[None])
    length = bodies.half_length[:, None] + bodies.half_length + margin[:, None]
    width = bodies.half_width[:, None] + bodies.half_width + margin[:, None]
    across = jnp.stack([-along[..., 1], along[..., 0]], axis=-1)
    axes = jnp.stack([along / length[..., None, None], across / width[..., None, None]], axis=-2)
    count = len(margin)
    meet = bodies.there[:, None] & bodies.there & ~jnp.eye(count, dtype=bool)
    return _Room(axes, jnp.where(meet, width, 0.0))


class _Conflicts(NamedTuple):
    """Depths of others in i's room, and derivatives by i's place; by j's they are the negative."""

    depth: Float[Array, "A A T"]
    slope: Float[Array, "A A T 2"]
    curvature: Float[Array, "A A T 2 2"]


def _conflicts(room: _Room, path: Float[Array, "A T 2"]) -> _Conflicts:
    """`depth = max(0, 1 - rho) width`, `rho` the distance in units of the ellipse."""
    away = path[:, None] - path[None]
    inside = jnp.einsum("ijtkl,ijtl->ijtk", room.axes, away)
    rho = jnp.sqrt(jnp.sum(inside**2, axis=-1) + NO_LENGTH**2)
    width = room.width[..., None]
    depth = jnp.maximum(1.0 - rho, 0.0) * width
    met = (depth > 0.0)[..., None]
    normal = jnp.einsum("ijtkl,ijtk->ijtl", room.axes, inside)
    slope = jnp.where(met, -width[..., None] * normal / rho[..., None], 0.0)
    square = jnp.einsum("ijtkl,ijtkm->ijtlm", room.axes, room.axes)
    bent = square / rho[..., None, None] - (
        normal[..., :, None] * normal[..., None, :] / rho[..., None, None] ** 3
    )
    curvature = jnp.where(met[..., None], -width[..., None, None] * bent, 0.0)
    return _Conflicts(depth, slope, curvature)


def _tracking(game: SmoothGame, basis: Basis) -> Float[Array, "A B B"]:
    """Second derivatives of the costs of leaving the preferred motion, per axis."""
    weight = discounts(game.traits, basis)
    left = jnp.einsum("at,tb,tc->abc", weight, basis.value, basis.value)
    effort = jnp.einsum("at,tb,tc->abc", weight, basis.acceleration, basis.acceleration)
    return 2.0 * (left + game.traits.effort[:, None, None] * effort)


def discounts(traits: Traits, basis: Basis) -> Float[Array, "A T"]:
    """Return `gamma_i^t`."""
    return jnp.exp(jnp.log(traits.gamma)[:, None] * basis.times)


def cost(game: SmoothGame, strategy: Float[Array, "A B 2"], basis: Basis) -> Float[Array, "A"]:
    """Return each agent's cost `J_i`, in the module's definition."""
    weight = discounts(game.traits, basis)
    departure = strategy - game.preferred
    left = jnp.einsum("tb,abk->atk", basis.value, departure)
    harder = jnp.einsum("tb,abk->atk", basis.acceleration, departure)
    found = _conflicts(_room(game, basis), positions(game.frames, strategy, basis))
    stage = (
        jnp.sum(left**2, axis=-1)
        + game.traits.effort[:, None] * jnp.sum(harder**2, axis=-1)
        + game.traits.conflict[:, None] * jnp.sum(found.depth**2, axis=1)
    )
    return jnp.sum(weight * stage, axis=-1)


def interactions(
    frames: Frames, bodies: Bodies, traits: Traits, strategy: Float[Array, "A B 2"], basis: Basis
) -> Bool[Array, "A A"]:
    """Return whether agent i pays for coming close to agent j at some step."""
    game = SmoothGame(frames, bodies, traits, strategy)
    found = _conflicts(_room(game, basis), positions(frames, strategy, basis))
    return jnp.any(found.depth > 0.0, axis=-1)


def gradients(
    game: SmoothGame, strategy: Float[Array, "A B 2"], basis: Basis
) -> Float[Array, "A B 2"]:
    """Return the gradient of each agent's cost by its own strategy; 0 at an equilibrium."""
    found = _conflicts(_room(game, basis), positions(game.frames, strategy, basis))
    weight = 2.0 * game.traits.conflict[:, None] * discounts(game.traits, basis)
    push = jnp.einsum("at,ajt,ajti->ati", weight, found.depth, found.slope)
    own = jnp.einsum("ati,aik,tb->abk", push, game.frames.rotation, basis.value)
    return jnp.einsum("abc,ack->abk", _tracking(game, basis), strategy - game.preferred) + own


def _jacobian(
    game: SmoothGame, strategy: Float[Array, "A B 2"], basis: Basis, curved: Scalar
) -> Float[Array, "AB2 AB2"]:
    """Derivatives of `gradients`, with this share (0 to 1) of the depths' own curvature, which may
    make a player's cost concave."""
    count, size, _ = strategy.shape
    found = _conflicts(_room(game, basis), positions(game.frames, strategy, basis))
    weight = 2.0 * game.traits.conflict[:, None] * discounts(game.traits, basis)
    bent = jnp.einsum("ijtk,ijtl->ijtkl", found.slope, found.slope)
    bent = bent + curved * found.depth[..., None, None] * found.curvature
    bent = weight[:, None, :, None, None] * bent
    rotation = game.frames.rotation
    pair = jnp.einsum("tb,tc,ijtkl->ijbckl", basis.value, basis.value, bent)
    mine = jnp.einsum("ibckl,ikm,iln->ibmcn", jnp.sum(pair, axis=1), rotation, rotation)
    cross = -jnp.einsum("ijbckl,ikm,jln->ibmjcn", pair, rotation, rotation)
    axes = jnp.eye(2, dtype=strategy.dtype)
    mine = mine + jnp.einsum("abc,mn->abmcn", _tracking(game, basis), axes)
    whole = cross + jnp.einsum("ij,ibmcn->ibmjcn", jnp.eye(count, dtype=strategy.dtype), mine)
    flat = whole.reshape(count * size * 2, count * size * 2)
    return flat + REGULARISATION * jnp.eye(len(flat), dtype=strategy.dtype)


class SmoothEquilibrium(NamedTuple):
    """Result of `equilibrium`."""

    strategy: Float[Array, "A B 2"]
    """Of an equilibrium; the preferred motion where none was found."""
    solved: Bool[Array, ""]
    """Whether it is one."""


def equilibrium(game: SmoothGame, basis: Basis) -> SmoothEquilibrium:
    """Return the equilibrium next to the preferred motions, and whether it was found.

    Differentiable in the game's arrays; where none was found, as the preferred motion is.
    """
    return _solution(game, basis)


@jax.custom_jvp
def _solution(game: SmoothGame, basis: Basis) -> SmoothEquilibrium:
    """Newton's method from the preferred motions, a fixed number of steps."""

    def step(k: Any, strategy: Any) -> Any:
        slope = gradients(game, strategy, basis)
        matrix = _jacobian(game, strategy, basis, jnp.where(k < APPROACH, 0.0, 1.0))
        return strategy - jnp.linalg.solve(matrix, slope.ravel()).reshape(slope.shape)

    found = jax.lax.fori_loop(0, APPROACH + FINISH, step, game.preferred)
    # Comparisons with a NaN are false.
    solved = jnp.max(jnp.abs(gradients(game, found, basis))) < TOLERANCE
    return SmoothEquilibrium(jnp.where(solved, found, game.preferred), solved)


@_solution.defjvp
def _solution_jvp(
    primals: tuple[SmoothGame, Basis], tangents: tuple[SmoothGame, Basis]
) -> tuple[SmoothEquilibrium, SmoothEquilibrium]:
    """Implicit function theorem on `gradients = 0`; the preferred motion's where it was not solved.

    Nothing of a game that was not solved, or is nearly singular, enters a derivative.
    """
    game, basis = primals
    strategy, solved = _solution(game, basis)
    change = jax.jvp(lambda g, b: gradients(g, strategy, b), primals, tangents)[1]
    matrix = _jacobian(game, strategy, basis, jnp.ones(()))
    eye = jnp.eye(len(matrix), dtype=matrix.dtype)
    probe = jnp.max(jnp.abs(jnp.linalg.solve(matrix, jnp.ones_like(matrix[0]))))
    regular = solved & (probe < MOST_RESPONSE)
    change = jnp.where(regular, change, 0.0).ravel()
    implied = -jnp.linalg.solve(jnp.where(regular, matrix, eye), change)
    preferred = jnp.asarray(tangents[0].preferred)
    slope = jnp.where(regular, implied.reshape(strategy.shape), preferred)
    nothing: Any = np.zeros(solved.shape, dtype=jax.dtypes.float0)
    return SmoothEquilibrium(strategy, solved), SmoothEquilibrium(slope, nothing)
