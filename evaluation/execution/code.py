"""Digest of the source code that determines the rows of a study."""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("foresight_env", "agents")
"""Packages that count whole, with their data files (shipped weights)."""
ROOMS = ("metrics", "rollout", "samples", "studies", "windows")
"""Packages of `evaluation` that compute rows; execution, reports and commands do not."""
FILES = ("training/generation.py", "training/names.py")
"""Other files of `evaluation` that compute rows."""
DATA = (".safetensors", ".json")
"""Endings of data files."""


@lru_cache(maxsize=1)
def code_digest() -> str:
    """Return the digest of this process's code, 16 hexadecimal digits, read once per process.

    Comments, docstrings and formatting do not count, nor do versions of Python and of other
    packages.
    """
    files = {}
    for name in PACKAGES:
        root = _root(name)
        files.update({f"{name}/{p.relative_to(root).as_posix()}": p for p in _files(root)})
    root = _root("evaluation")
    chosen = [p for room in ROOMS for p in _files(root / room)] + [root / name for name in FILES]
    files.update({f"evaluation/{p.relative_to(root).as_posix()}": p for p in chosen})
    return digest_of(files)


def digest_of(files: dict[str, Path]) -> str:
    """Return the digest of files, each under the name that it counts by."""
    found = hashlib.sha256()
    for name in sorted(files):
        data = files[name].read_bytes()
        if name.endswith(".py"):
            data = repr(_syntax(ast.parse(data))).encode()
        found.update(f"{name}\n{len(data)}\n".encode())
        found.update(data)
    return found.hexdigest()[:16]


def _root(package: str) -> Path:
    spec = find_spec(package)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"{package}: no such package", name=package)
    return Path(spec.origin).parent


def _files(folder: Path) -> Iterator[Path]:
    for path in folder.rglob("*"):
        if path.suffix in (".py", *DATA) and not path.name.startswith("."):
            yield path


def _syntax(node: object) -> object:
    """A syntax tree as nested tuples, without positions, docstrings and empty fields.

    Not `ast.dump`, whose output depends on the version of Python.
    """
    if isinstance(node, ast.AST):
        fields = ((name, getattr(node, name, None)) for name in node._fields)
        return type(node).__name__, *((n, _syntax(v)) for n, v in fields if v not in (None, []))
    if isinstance(node, list):
        return tuple(_syntax(child) for child in node if not _is_text(child))
    return repr(node)


def _is_text(node: object) -> bool:
    """Whether a statement is a bare text, as docstrings are."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )
