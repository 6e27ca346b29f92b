"""Many games in lockstep: batch slots that never wait for a slow neighbour.

Under `vmap` every game runs until the slowest one is done. Here a fixed number of slots steps
together, and a slot whose game has ended takes the next one that waits.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from foresight_env.compilation import compiled
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.newton.implicit import Equilibrium, result_of
from foresight_env.equilibrium.newton.phase import (
    PhaseState,
    accuracy_of,
    init_phase,
    phase_ended,
    step_phase,
)
from foresight_env.equilibrium.newton.schedule import phase_count, phase_rules
from foresight_env.equilibrium.newton.start import Start, begin, begin_phase
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.equilibrium.solve import Solution, to_solution
from foresight_env.games.types import AnyArray


class _Slot(NamedTuple):
    """One slot's work."""

    game: Int[Array, ""]
    """Its game's place in the batch."""
    phase: Int[Array, ""]
    spent: Int[Array, ""]
    """Newton steps of the phases before."""
    state: PhaseState


def _choose(condition: Array, yes: Any, no: Any) -> Any:
    """Entry by entry of the leading axes that `condition` has."""

    def choose(a: Array, b: Array) -> Array:
        return jnp.where(
            condition.reshape(condition.shape + (1,) * (a.ndim - condition.ndim)), a, b
        )

    return jax.tree.map(choose, yes, no)


@compiled(static_argnums=(0, 1, 2))
def solve_in_slots(
    layout: Layout,
    options: SolverOptions,
    width: int,
    parameters: Parameters,
    initial_guess: Iterate | None,
    active: Int[AnyArray, ""],
) -> Solution:
    """Solve the first `active` games of a batch, `width` of them at a time."""
    count = parameters.gamma.shape[0]
    accuracy = accuracy_of(options, None)
    starts: Start = jax.vmap(lambda p, s: begin(layout, options, p, s))(parameters, initial_guess)
    warm = None if starts.warm is None else jnp.ones((), bool)
    first = 1 if warm is None else 0
    last = phase_count(options, warm, None)

    def of(tree: Any, game: Array) -> Any:
        """Entries of these games; slots without one get the last game's."""
        return jax.tree.map(lambda v: v[jnp.minimum(game, count - 1)], tree)

    def renewed(game: Array, phase: Array) -> PhaseState:
        """The states at the beginning of these games' phases."""

        def one(mine: Parameters, start: Start, number: Array) -> PhaseState:
            point = begin_phase(layout, options, mine, start, number)
            rules = phase_rules(layout, options, number, warm, None)
            return init_phase(layout, mine, point, rules, accuracy)

        return jax.vmap(one)(of(parameters, game), of(starts, game), phase)

    def ended(slots: _Slot) -> Bool[Array, "slots"]:
        def one(number: Array, state: PhaseState) -> Array:
            rules = phase_rules(layout, options, number, warm, None)
            return phase_ended(layout, options, state, rules, accuracy)

        return jax.vmap(one)(slots.phase, slots.state)

    def stepped(slots: _Slot) -> PhaseState:
        def one(mine: Parameters, number: Array, state: PhaseState) -> PhaseState:
            rules = phase_rules(layout, options, number, warm, None)
            return step_phase(layout, options, mine, state, rules, accuracy)

        return jax.vmap(one)(of(parameters, slots.game), slots.phase, slots.state)

    def results(slots: _Slot) -> Equilibrium:
        spent = slots.spent + slots.state.iteration
        return jax.vmap(lambda state, n: result_of(state, n, accuracy))(slots.state, spent)

    def body(carried: tuple[_Slot, Equilibrium, Array]) -> tuple[_Slot, Equilibrium, Array]:
        slots, found, waiting = carried
        # Slots without a game stay as they are.
        turning = ended(slots) & (slots.game < active)

        def turn() -> tuple[_Slot, Equilibrium, Array]:
            result = results(slots)
            done = turning & (result.success | (slots.phase >= last)) & (slots.game < active)
            # Slots still at work write beyond the end, which is dropped.
            place = jnp.where(done, slots.game, count)
            kept = jax.tree.map(lambda all_, v: all_.at[place].set(v, mode="drop"), found, result)
            following = jnp.minimum(waiting + jnp.cumsum(done) - 1, count)
            game = jnp.where(done, following, slots.game)
            phase = jnp.where(done, first, slots.phase + turning)
            spent = jnp.where(done, 0, jnp.where(turning, result.iterations, slots.spent))
            state = _choose(turning, renewed(game, phase), slots.state)
            return _Slot(game, phase, spent, state), kept, waiting + jnp.sum(done)

        slots, found, waiting = jax.lax.cond(
            jnp.any(turning), turn, lambda: (slots, found, waiting)
        )
        # A phase that begins at a solution has ended before its first step.
        state = _choose(ended(slots), slots.state, stepped(slots))
        return slots._replace(state=state), found, waiting

    def busy(carried: tuple[_Slot, Equilibrium, Array]) -> Bool[Array, ""]:
        return jnp.any(carried[0].game < active)

    games = jnp.arange(width)
    zeros = jnp.zeros(width, int)
    slots = _Slot(games, zeros + first, zeros, renewed(games, zeros + first))
    shapes = jax.eval_shape(results, slots)
    found = jax.tree.map(lambda v: jnp.zeros((count, *v.shape[1:]), v.dtype), shapes)
    begun = (slots, found, jnp.asarray(min(width, count)))
    _, found, _ = jax.lax.while_loop(busy, body, begun)
    return jax.vmap(partial(to_solution, layout, options))(found, parameters)
