"""Inverse methods as PyTrees of their settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import Any, TypeVar

import jax

T = TypeVar("T")


def register_method(cls: type[T]) -> type[T]:
    """Register a frozen dataclass as a PyTree of its fields.

    As `jax.tree_util.register_dataclass`, but instances that JAX makes, of tracers or descriptions
    of arrays, pass no `__init__` with its checks of types and values.
    """
    names = [field.name for field in fields(cls)]  # type: ignore[arg-type]

    def flatten(method: T) -> tuple[list[tuple[Any, Any]], None]:
        return [(jax.tree_util.GetAttrKey(n), getattr(method, n)) for n in names], None

    def unflatten(_: None, values: Iterable[Any]) -> T:
        method = object.__new__(cls)
        for name, value in zip(names, values, strict=True):
            object.__setattr__(method, name, value)
        return method

    jax.tree_util.register_pytree_with_keys(cls, flatten, unflatten)
    return cls
