"""Check of prose for words that this project avoids: `python -m tests.support.plain_words`.

The list with replacements is `plain_words.toml`. Prose is: docstrings, comments and texts with a
space in Python files, without code in backticks and fields in braces; Markdown without code; cells
of notebooks; pages of the report.
"""

from __future__ import annotations

import ast
import io
import json
import re
import subprocess
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
WORDS = Path(__file__).with_suffix(".toml")
SUFFIXES = (".py", ".md", ".ipynb", ".html")


class Words(NamedTuple):
    """The list: regular expressions of words, with replacements."""

    anywhere: dict[str, str]
    first: dict[str, str]
    """Of the first word of a docstring."""


class Found(NamedTuple):
    """A word that is to be replaced."""

    line: int
    word: str
    instead: str


def read_words() -> Words:
    """Return the list of `plain_words.toml`."""
    return Words(**tomllib.loads(WORDS.read_text(encoding="utf-8")))


def without_code(text: str) -> str:
    """Return text with code in backticks, fields in braces and addresses blanked."""
    blank = r"`[^`]*`|\{\{.*?\}\}|\{%.*?%\}|\{[^{}]*\}|\]\([^)]*\)|https?://\S+"
    return re.sub(blank, lambda m: " " * len(m.group()), text)


def prose_of(path: Path, text: str) -> Iterator[tuple[int, str]]:
    """Yield line numbers and lines of prose."""
    if path.suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            kind = tokenize.tok_name[token.type]
            prose = kind in ("STRING", "FSTRING_MIDDLE") and " " in token.string
            if kind == "COMMENT" or prose:
                yield from enumerate(token.string.splitlines(), token.start[0])
    elif path.suffix == ".ipynb":
        for cell in json.loads(text)["cells"]:
            for line in "".join(cell["source"]).splitlines():
                code = cell["cell_type"] == "code"
                yield 0, line.partition("#")[2] if code else line
    else:
        code = False
        for number, line in enumerate(text.splitlines(), 1):
            code = code != line.lstrip().startswith("```")
            if not code:
                yield number, line


def first_words(text: str) -> Iterator[tuple[int, str]]:
    """Yield line numbers and first words of docstrings, those of fields and constants included."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            value = node.value.value
            if isinstance(value, str) and value.split():
                yield node.lineno, value.split()[0]


def check(path: Path, text: str, words: Words) -> list[Found]:
    """Return the words in a file that are to be replaced."""
    found = []
    for number, line in prose_of(path, text):
        for word, instead in words.anywhere.items():
            for match in re.finditer(rf"\b(?:{word})\b", without_code(line), re.IGNORECASE):
                found.append(Found(number, match.group(), instead))
    if path.suffix == ".py":
        for number, first in first_words(text):
            for word, instead in words.first.items():
                if re.fullmatch(word, first, re.IGNORECASE):
                    found.append(Found(number, first, instead))
    return found


def main() -> int:
    """Print every place in the files that git knows; return 1 where there is one."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    words = read_words()
    count = 0
    for name in listed.split("\0"):
        path = ROOT / name
        if path.suffix not in SUFFIXES or not path.is_file():
            continue
        for place in check(path, path.read_text(encoding="utf-8"), words):
            print(f"{name}:{place.line}: {place.word!r}; write: {place.instead}")
            count += 1
    print(f"plain words: {count} to replace" if count else "plain words: none to replace")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
