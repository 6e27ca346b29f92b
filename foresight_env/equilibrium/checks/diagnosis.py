"""Diagnosis of a solve that cannot begin: the functions that are not finite at its start."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from foresight_env.equilibrium.checks.named import parts_of
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import Layout
from foresight_env.equilibrium.conditions.rollout import rollout
from foresight_env.games.types import AnyArray


def check_start_is_finite(
    layout: Layout, parameters: Parameters, initial_guess: Iterate | AnyArray | None
) -> None:
    """Raise `ValueError` naming a function whose value or derivatives are NaN or infinite.

    At the trajectory that a solve begins with: zero controls, or the initial guess.
    """
    if initial_guess is not None and not all(
        np.isfinite(v).all() for v in jax.tree.leaves(initial_guess)
    ):
        raise ValueError("initial_guess: contains NaN or infinity; expected finite numbers")
    controls: Any = initial_guess.u if isinstance(initial_guess, Iterate) else initial_guess
    with jax.enable_x64(True):
        u = (
            jnp.zeros((layout.game.horizon, layout.m))
            if initial_guess is None
            else jnp.asarray(controls)
        )
        initial_state = jnp.asarray(parameters.initial_state)
        after = jnp.asarray(
            initial_guess.x
            if isinstance(initial_guess, Iterate)
            else rollout(layout, initial_state, u)
        )
        before = jnp.concatenate([initial_state[None], after[:-1]])
        for part in parts_of(layout.game):
            starts = before if part.before else after

            def value(t: Any, w: Any, part: Any = part) -> Any:
                return jnp.asarray(part.function(t, *layout.split(w), parameters.theta))

            derivatives = {
                "value": value,
                "first derivative": jax.jacfwd(value, argnums=1),
                "second derivative": jax.jacfwd(jax.jacrev(value, argnums=1), argnums=1),
            }
            stages, points = jnp.arange(1, layout.game.horizon + 1), jnp.hstack([starts, u])
            for kind, function in derivatives.items():
                found = np.asarray(jax.vmap(function)(stages, points))
                bad = ~np.isfinite(found).reshape(len(found), -1).all(axis=1)
                if bad.any():
                    raise ValueError(
                        f"{part.name}: its {kind} is not finite at stage {int(bad.argmax()) + 1} "
                        "of the trajectory that the solve starts from; functions must be smooth "
                        "there (a square root or a norm at 0 is not: add a small constant inside)"
                    )
