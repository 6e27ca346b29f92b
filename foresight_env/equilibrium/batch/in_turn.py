"""Many games one after the other, in one program.

A step of a single game does what this game needs (semismooth or interior-point, one right-hand
side or two); steps of several games together do all of it for each.
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from foresight_env.compilation import compiled
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.newton.implicit import Equilibrium, equilibrium
from foresight_env.equilibrium.newton.start import begin
from foresight_env.equilibrium.settings import SolverOptions
from foresight_env.equilibrium.solve import Solution, to_solution
from foresight_env.games.types import AnyArray


@compiled(static_argnums=(0, 1))
def solve_in_turn(
    layout: Layout,
    options: SolverOptions,
    parameters: Parameters,
    initial_guess: Iterate | None,
    active: Int[AnyArray, ""],
) -> Solution:
    """The first `active` games of a batch."""

    def one(number: Array) -> Equilibrium:
        mine, near = jax.tree.map(lambda v: v[number], (parameters, initial_guess))
        found: Equilibrium = equilibrium(layout, options, mine, begin(layout, options, mine, near))
        return found._replace(evaluation=None)

    def body(number: Array, found: Equilibrium) -> Equilibrium:
        return jax.tree.map(lambda all_, v: all_.at[number].set(v), found, one(number))

    shapes = jax.eval_shape(one, jnp.zeros((), int))
    count = parameters.gamma.shape[0]
    found = jax.tree.map(lambda v: jnp.zeros((count, *v.shape), v.dtype), shapes)
    found = jax.lax.fori_loop(0, active, body, found)
    return jax.vmap(partial(to_solution, layout, options))(found, parameters)
