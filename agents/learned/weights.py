"""Weights in files: safetensors, which hold arrays and no code, with a JSON file of metadata."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

FOLDER = Path(__file__).parent / "shipped"
"""Folder of the shipped weights."""


def arrays_of(tree: Any) -> dict[str, np.ndarray]:
    """A PyTree's arrays by their places in it."""
    leaves = jax.tree_util.tree_leaves_with_path(eqx.filter(tree, eqx.is_array))
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def with_arrays(tree: Any, arrays: dict[str, np.ndarray], what: str) -> Any:
    """The tree with these arrays; `ValueError` where they do not fit.

    Arrays of half precision (`halved`) get the precision of the tree's.
    """
    wanted = arrays_of(tree)
    if wanted.keys() != arrays.keys():
        odd = sorted(wanted.keys() ^ arrays.keys())[0]
        raise ValueError(f"{what}: is of another network ({odd}); train it again")
    for name, value in wanted.items():
        found = arrays[name]
        if found.dtype == np.float16 and value.dtype == np.float32:
            arrays = {**arrays, name: (found := found.astype(np.float32))}
        if found.shape != value.shape or found.dtype != value.dtype:
            raise ValueError(
                f"{what}: {name} has shape {found.shape} of {found.dtype}; expected "
                f"{value.shape} of {value.dtype}"
            )
    dynamic, static = eqx.partition(tree, eqx.is_array)
    flat = jax.tree_util.tree_map_with_path(
        lambda path, leaf: jax.numpy.asarray(arrays[jax.tree_util.keystr(path)]), dynamic
    )
    return eqx.combine(flat, static)


def halved(tree: Any) -> Any:
    """The tree with its arrays of single precision rounded to half, so that files are smaller."""
    return _converted(tree, np.float32, np.float16)


def single(tree: Any) -> Any:
    """The tree with its arrays of half precision in single precision."""
    return _converted(tree, np.float16, np.float32)


def _converted(tree: Any, old: Any, new: Any) -> Any:
    def convert(leaf: Any) -> Any:
        return leaf.astype(new) if eqx.is_array(leaf) and leaf.dtype == old else leaf

    return jax.tree.map(convert, tree)


def packed(tree: Any, about: dict[str, str] | None = None) -> bytes:
    """A tree's arrays as the contents of a file; `about`: the file's metadata."""
    arrays = {name: np.asarray(v, order="C") for name, v in arrays_of(tree).items()}
    found: bytes = save(arrays, about)
    return found


def unpacked(tree: Any, data: bytes, what: str) -> Any:
    """The tree with what `packed` made; `what` names the file in errors."""
    try:
        arrays = load(data)
    except SafetensorError as error:
        raise ValueError(f"{what}: is damaged ({error})") from error
    return with_arrays(tree, arrays, what)


def load_network(path: Path, make: Callable[[dict[str, Any]], Any]) -> tuple[Any, dict[str, Any]]:
    """A network from `path` (.safetensors), and its JSON metadata.

    `make`: from that, a network of the right shapes.
    """
    about = path.with_suffix(".json")
    for file in (path, about):
        if not file.is_file():
            raise ValueError(f"{file}: is missing; train it, or name another file")
    try:
        description = json.loads(about.read_text())
    except json.JSONDecodeError as error:
        raise ValueError(f"{about}: is not JSON ({error})") from error
    return unpacked(make(description), path.read_bytes(), str(path)), description
