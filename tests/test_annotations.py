"""Every name that an annotation uses is defined in its module.

With `from __future__ import annotations` a name that is imported nowhere is an error only for
those who evaluate annotations: run-time checkers, documentation tools, dataclass libraries.
"""

import ast
import builtins
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("foresight_env", "agents", "evaluation", "benchmarks")
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))

ARRAY_KINDS = frozenset(dir(jaxtyping))
"""Of jaxtyping: the second entry of their subscript is a shape, such as `Float[Array, "T n"]`."""


def annotations_of(tree: ast.AST) -> Iterator[ast.expr]:
    """All annotations of a module: of arguments, returns, variables and fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.returns:
            yield node.returns
        elif isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
            yield node.annotation


def last_name(node: ast.expr) -> str:
    """`Float` of `Float` and of `jaxtyping.Float`."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def names_in(annotation: ast.expr) -> Iterator[ast.Name]:
    """Names that an annotation uses, those in text that parses included; shapes and literals are
    text and nothing else."""
    if isinstance(annotation, ast.Name):
        yield annotation
    elif isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        try:
            inner = ast.parse(annotation.value.strip(), mode="eval").body
        except SyntaxError:
            return
        for name in names_in(inner):
            yield ast.copy_location(name, annotation)
    elif isinstance(annotation, ast.Subscript):
        yield from names_in(annotation.value)
        kind, inside = last_name(annotation.value), annotation.slice
        entries = inside.elts if isinstance(inside, ast.Tuple) else [inside]
        if kind == "Literal":
            return
        for k, entry in enumerate(entries):
            if k > 0 and kind == "Annotated":
                yield from (node for node in ast.walk(entry) if isinstance(node, ast.Name))
            elif k == 0 or kind not in ARRAY_KINDS:
                yield from names_in(entry)
    else:
        for child in ast.iter_child_nodes(annotation):
            if isinstance(child, ast.expr):
                yield from names_in(child)


FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def outside_functions(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that are not part of a function's body."""
    for child in ast.iter_child_nodes(tree):
        yield child
        if not isinstance(child, FUNCTIONS):
            yield from outside_functions(child)


def bound_names(tree: ast.AST) -> set[str]:
    """Names that a module defines: imports, classes, functions, assignments outside functions and
    type parameters. Imports under `TYPE_CHECKING` count."""
    bound: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            bound |= {(alias.asname or alias.name).partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            bound.add(node.name)
            bound |= {parameter.name for parameter in getattr(node, "type_params", ())}
    return bound | {
        node.id
        for node in outside_functions(tree)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }


def undefined_names(source: str) -> list[str]:
    """Names in annotations that are neither defined in the module nor built in."""
    tree = ast.parse(source)
    known = bound_names(tree) | set(vars(builtins))
    used = (name for annotation in annotations_of(tree) for name in names_in(annotation))
    return sorted({f"line {name.lineno}: {name.id}" for name in used if name.id not in known})


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_annotations_use_defined_names(path: Path) -> None:
    assert undefined_names(path.read_text()) == []


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("def f(a: Missing) -> None: ...", "Missing"),
        ("def f(*args: Missing, **kwargs: int) -> None: ...", "Missing"),
        ("def f() -> tuple[Missing, ...]: ...", "Missing"),
        ("x: dict[str, Missing] = {}", "Missing"),
        ("class A:\n    field: Missing", "Missing"),
        ("def f(a: 'list[Missing]') -> None: ...", "Missing"),
        ("def f(a: Float[Missing, 'T n']) -> None: ...", "Missing"),
        ("def f(a: int | Missing) -> None: ...", "Missing"),
    ],
)
def test_a_planted_name_is_found(line: str, name: str) -> None:
    source = f"from __future__ import annotations\nfrom jaxtyping import Float\n{line}\n"
    (found,) = undefined_names(source)
    assert found.endswith(f": {name}")


@pytest.mark.parametrize(
    "line",
    [
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import a.b\ndef f(x: a.C): ...",
        "from jaxtyping import Float, Array\ndef f(x: Float[Array, 'horizon players']): ...",
        "from typing import Literal\nx: Literal['left', 'right'] = 'left'",
        "class Own:\n    def other(self) -> 'Own': ...",
        "from typing import TypeVar\nT = TypeVar('T')\ndef f(x: T) -> T: ...",
    ],
)
def test_defined_names_and_shapes_are_left_alone(line: str) -> None:
    assert undefined_names(line) == []
