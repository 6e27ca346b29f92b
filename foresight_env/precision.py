"""Double precision inside solvers and estimators, whatever the caller's JAX configuration.

Nothing here changes that configuration: the switch is a context of the calling thread. Concrete
calls get NumPy float64 arrays back; calls under `jit`, `vmap` or `grad` get arrays of the caller's
own precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

P = ParamSpec("P")
R = TypeVar("R")


def is_traced(*trees: Any) -> bool:
    """Whether any leaf is a JAX tracer."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def to_double(tree: Any) -> Any:
    """Floating leaves (and Python numbers) as float64; integers and booleans as they are."""

    def convert(leaf: Any) -> Any:
        if isinstance(leaf, jax.core.Tracer):
            floating = jnp.issubdtype(leaf.dtype, jnp.floating)
            return jax.lax.convert_element_type(leaf, jnp.float64) if floating else leaf
        array = np.asarray(leaf)
        return array.astype(np.float64) if array.dtype.kind == "f" else array

    return jax.tree.map(convert, tree)


def to_numpy(tree: Any) -> Any:
    """Concrete JAX arrays as NumPy arrays; tracers as they are."""
    return jax.tree.map(lambda v: np.asarray(v) if _is_concrete(v) else v, tree)


def _is_concrete(leaf: Any) -> bool:
    return isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer)


def in_double_precision(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` on concrete arguments with 64-bit types enabled; NumPy arrays come back."""

    @wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with jax.enable_x64(True):
            return to_numpy(function(*args, **kwargs))

    return wrapped


def call_in_double(function: Callable[[Any], Any], argument: Any) -> Any:
    """`function(argument)` in double precision, for callers that trace in single precision.

    `argument` and the result are PyTrees of floating arrays (other leaves of the result pass
    through without derivative). The Jacobian is formed in double precision and handed over as a
    matrix: the caller's own transposition then never meets a 64-bit operation outside the 64-bit
    context.
    """
    leaves, structure = jax.tree.flatten(argument)
    traced = [k for k, leaf in enumerate(leaves) if isinstance(leaf, jax.core.Tracer)]
    shapes = [leaves[k].shape for k in traced]
    ends = np.cumsum([math.prod(s) for s in shapes])[:-1].tolist()
    flat = jnp.concatenate([jnp.ravel(leaves[k]).astype(jnp.float32) for k in traced])

    def wide(values: Any) -> Any:
        full = list(leaves)  # concrete leaves keep their double precision
        for k, part, shape in zip(traced, jnp.split(values, ends), shapes, strict=True):
            full[k] = part.reshape(shape)
        return function(jax.tree.unflatten(structure, full))

    def narrowed(tree: Any) -> Any:
        return jax.tree.map(
            lambda v: jax.lax.convert_element_type(
                v, jnp.float32 if jnp.issubdtype(v.dtype, jnp.floating) else jnp.int32
            ),
            tree,
        )

    @jax.custom_jvp
    def call(values: Any) -> Any:
        with jax.enable_x64(True):
            return narrowed(wide(to_double(values)))

    @call.defjvp
    def call_jvp(primals: Any, tangents: Any) -> Any:
        (values,), (change,) = primals, tangents
        result = call(values)
        with jax.enable_x64(True):
            jacobian = narrowed(jax.jacfwd(lambda v: _floats(wide(v)))(to_double(values)))
        rates = iter(jacobian)

        def tangent(v: Any) -> Any:
            if not jnp.issubdtype(v.dtype, jnp.floating):
                return np.zeros(v.shape, jax.dtypes.float0)
            return next(rates) @ change

        return result, jax.tree.map(tangent, result)

    return call(flat)


def _floats(tree: Any) -> list[Any]:
    return [v for v in jax.tree.leaves(tree) if jnp.issubdtype(v.dtype, jnp.floating)]
