"""Games that step together, in lanes that never wait for a slow neighbour.

Under `vmap` every game runs until the slowest one is done. Here a fixed number of lanes steps
together, and a lane whose game has ended takes the next one that waits.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import evaluate, violation
from foresight_env.equilibrium.newton.convexification import next_convexity, used_convexity
from foresight_env.equilibrium.newton.implicit import Equilibrium
from foresight_env.equilibrium.newton.interior_point import (
    SolverOptions,
    accuracy_of,
    astray,
    converged,
    hopeless,
    is_finite,
    newton_step,
)
from foresight_env.equilibrium.newton.phases import attempt_count, attempt_rules
from foresight_env.equilibrium.newton.start import Start, begin, begin_attempt
from foresight_env.equilibrium.solve import Solution, to_solution
from foresight_env.games.types import AnyArray


class _Lane(NamedTuple):
    """One lane's work; `number` is the game's place in the batch."""

    number: Int[Array, ""]
    attempt: Int[Array, ""]
    iteration: Int[Array, ""]
    spent: Int[Array, ""]
    error: Float[Array, ""]
    """That of the point before; infinite at an attempt's start."""
    begun: Float[Array, ""]
    """That of the attempt's first point, once it is known."""
    convexity: Float[Array, ""]
    taken: Float[Array, ""]
    """The part of the last step; none at an attempt's start."""
    point: Iterate
    safe: Iterate
    """The last point at which everything was finite."""
    broken: Bool[Array, ""]
    """A step overflowed: `point` is the safe one again, and the attempt ends."""


def _fresh(number: Array, attempt: Array, spent: Array, point: Iterate) -> _Lane:
    zero, nothing = jnp.zeros((), int), jnp.zeros(())
    large, never = jnp.asarray(jnp.inf), jnp.zeros((), bool)
    return _Lane(
        number, attempt, zero, spent, large, large, jnp.ones(()), nothing, point, point, never
    )


def _advance(
    layout: Layout, options: SolverOptions, mine: Parameters, lane: _Lane, *, cold: bool
) -> tuple[_Lane, Equilibrium, Bool[Array, ""], Bool[Array, ""]]:
    """One step of one lane; its result so far, whether it is solved, whether it is stuck."""
    pairs, accuracy = pairs_of(layout), accuracy_of(options, None)
    local = None if cold else lane.attempt == 0
    near = None if cold else jnp.ones((), bool)
    exact_below, limit = attempt_rules(layout, options, lane.attempt, near)
    if local is not None:
        exact_below = jnp.where(local, jnp.inf, exact_below)
        limit = jnp.where(local, options.local_steps, limit)
    used = used_convexity(lane.convexity, lane.error, exact_below)
    ev = evaluate(layout, pairs, lane.point, mine, used, accuracy.barrier)
    convexity = next_convexity(layout, lane.convexity, lane.error, ev.error, lane.taken)
    finite = is_finite(lane.point, ev)
    solved = converged(ev, accuracy) & finite & ~lane.broken
    begun = jnp.where(lane.iteration == 0, ev.error, lane.begun)
    done = hopeless(layout, lane.point, ev) | (lane.iteration >= limit)
    done |= astray(local, lane.iteration, ev.error, begun)
    # A lane that broke ends its attempt even where its start was not finite either.
    stuck = lane.broken | (finite & ~solved & done)
    result = Equilibrium(
        lane.point,
        ev.q,
        jnp.where(lane.broken, jnp.inf, ev.error),
        ev.complementarity,
        violation(ev),
        lane.spent,
        solved,
    )
    used = used_convexity(convexity, ev.error, exact_below)
    stepped, taken = newton_step(layout, pairs, lane.point, ev, accuracy.barrier, local, used)
    lane = lane._replace(
        iteration=lane.iteration + 1,
        spent=lane.spent + finite,
        error=ev.error,
        begun=begun,
        convexity=convexity,
        taken=taken,
        point=_choose(finite, stepped, lane.safe),
        safe=_choose(finite, lane.point, lane.safe),
        broken=~finite,
    )
    return lane, result, solved, stuck


def _choose(condition: Array, yes: Any, no: Any) -> Any:
    """Entry by entry of the leading axes that `condition` has."""

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(
            condition.reshape(condition.shape + (1,) * (a.ndim - condition.ndim)), a, b
        )

    return jax.tree.map(choose, yes, no)


@partial(jax.jit, static_argnums=(0, 1, 2))
def solve_in_slots(
    layout: Layout,
    options: SolverOptions,
    width: int,
    parameters: Parameters,
    initial_guess: Iterate | None,
    active: Int[AnyArray, ""],
) -> Solution:
    """The first `active` games of a batch, `width` of them at a time."""
    count = parameters.gamma.shape[0]
    starts: Start = jax.vmap(lambda p, s: begin(layout, options, p, s))(parameters, initial_guess)
    first = 1 if starts.near is None else 0
    attempts = attempt_count(options, None if starts.near is None else starts.near[0])

    def of(tree: Any, number: Array) -> Any:
        """Entries of these games; lanes without one get the last game's."""
        return jax.tree.map(lambda v: v[jnp.minimum(number, count - 1)], tree)

    def attempt(lanes: _Lane) -> Iterate:
        again = jax.vmap(partial(begin_attempt, layout, options))
        return again(of(parameters, lanes.number), of(starts, lanes.number), lanes.attempt)

    def renewed(lanes: _Lane) -> _Lane:
        """The lanes at the start of their game's attempt."""
        return jax.vmap(_fresh)(lanes.number, lanes.attempt, lanes.spent, attempt(lanes))

    numbers, zeros = jnp.arange(width), jnp.zeros(width, int)
    begun = of(starts.point, numbers)
    lanes = renewed(jax.vmap(_fresh)(numbers, zeros + first, zeros, begun))
    advance = jax.vmap(partial(_advance, layout, options, cold=starts.near is None))
    shapes = jax.eval_shape(advance, of(parameters, numbers), lanes)[1]
    found = jax.tree.map(lambda v: jnp.zeros((count, *v.shape[1:]), v.dtype), shapes)

    def body(state: tuple[_Lane, Equilibrium, Array]) -> tuple[_Lane, Equilibrium, Array]:
        lanes, found, waiting = state
        lanes, result, solved, stuck = advance(of(parameters, lanes.number), lanes)
        ended = solved | (stuck & (lanes.attempt >= attempts))
        ended &= lanes.number < active
        # Lanes still at work write beyond the end, which is dropped.
        place = jnp.where(ended, lanes.number, count)
        found = jax.tree.map(lambda all_, v: all_.at[place].set(v, mode="drop"), found, result)
        following = jnp.minimum(waiting + jnp.cumsum(ended) - 1, count)
        turned = lanes._replace(
            number=jnp.where(ended, following, lanes.number),
            attempt=jnp.where(ended, first, lanes.attempt + 1),
            spent=jnp.where(ended, 0, result.iterations),
        )
        turning = ended | stuck
        lanes = jax.lax.cond(
            jnp.any(turning), lambda: _choose(turning, renewed(turned), lanes), lambda: lanes
        )
        return lanes, found, waiting + jnp.sum(ended)

    def busy(state: tuple[_Lane, Equilibrium, Array]) -> Bool[Array, ""]:
        return jnp.any(state[0].number < active)

    state = (lanes, found, jnp.asarray(min(width, count)))
    _, found, _ = jax.lax.while_loop(busy, body, state)
    return jax.vmap(partial(to_solution, layout))(found, parameters)
