"""The page of the command line: `python -m evaluation.cli.reference > docs/command_line.md`."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer

from evaluation.cli.app import app

HEADING = """# Command line

Every command and option, as `--help` prints them. Written by
`python -m evaluation.cli.reference > docs/command_line.md`; do not edit.

`-h` or `--help` lists the options of a command, `--version` prints the version, and
`python -m evaluation` is the same command. Studies run on every core or on a Dask cluster, resume
after interruption, and keep their rows in the folder `--out`: one folder holds the rows of one
study, computed by one version of the code.

| question | command |
|---|---|
| What does an episode look like? | `run` |
| What do my recordings say? | `estimate` |
| All parts in small | `demo` |
| What is knowing the others' foresight worth? | `value` |
| How do egos and estimates compare? | `evaluate crosswalk`, `evaluate driving` |
| Who collides, and under which surprises? | `evaluate safety` |
| Who predicts recorded agents best? | `evaluate intersection`, `evaluate prediction` |
| Everything against everything | `benchmark` |
| A page from results | `report` |
| Data and networks | `generate`, `train` |
"""


FIRST = ("run", "estimate", "demo", "value", "evaluate")
"""Commands that the page begins with."""


def command_reference() -> str:
    """Return the page as Markdown, generated from the command itself."""
    return "\n".join([HEADING, *_sections(typer.main.get_command(app), ("foresight",))])


def _sections(command: Any, names: tuple[str, ...]) -> Iterator[str]:
    """Yield the parts of a command's commands, depth first."""
    commands = getattr(command, "commands", {})
    first = [name for name in FIRST if name in commands]
    for name in dict.fromkeys([*first, *commands]):
        part = commands[name]
        if getattr(part, "commands", None):
            yield from _sections(part, (*names, name))
        else:
            yield from _command(part, (*names, name))


def _command(command: Any, names: tuple[str, ...]) -> Iterator[str]:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    called = " ".join([*names, *(str(a.metavar or a.name).upper() for a in arguments)])
    yield f"## {' '.join(names[1:])}\n"
    yield f"    {called}\n"
    yield f"{_plain(inspect.cleandoc(command.help))}\n"
    for argument in arguments:
        yield f"- `{str(argument.metavar or argument.name).upper()}`: {_plain(argument.help)}"
    for option in options:
        names_of = " / ".join([*option.opts, *option.secondary_opts])
        yield f"- `{names_of}`{_default(option)}: {_plain(option.help)}"
    yield ""


def _default(option: Any) -> str:
    value = option.default
    if callable(value) or value is None or value is False or value == "":
        return ""
    if value is True:
        return f" (default `{option.opts[0]}`)"
    return f" (default `{value}`)"


def _plain(text: str | None) -> str:
    """Return a help text in which Markdown finds no markup other than code."""
    escaped = [
        part if k % 2 else part.replace("*", r"\*").replace("_", r"\_").replace("<", r"\<")
        for k, part in enumerate((text or "").split("`"))
    ]
    return "`".join(escaped)


if __name__ == "__main__":
    print(command_reference(), end="")
