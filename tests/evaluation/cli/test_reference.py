"""The page of the command line is that of the command."""

from pathlib import Path

import typer

from evaluation.cli.app import app
from evaluation.cli.reference import command_reference

PAGE = Path(__file__).parents[3] / "docs" / "command_line.md"


def leaves(command):
    for part in command.commands.values():
        yield from leaves(part) if getattr(part, "commands", None) else (part,)


def test_the_page_is_up_to_date():
    """Else: `python -m evaluation.cli.reference > docs/command_line.md`."""
    assert PAGE.read_text(encoding="utf-8") == command_reference()


def test_the_page_has_every_option():
    page = command_reference()
    commands = list(leaves(typer.main.get_command(app)))
    assert len(commands) > 10
    assert page.count("\n## ") == len(commands)
    for command in commands:
        for parameter in command.params:
            if parameter.param_type_name == "option" and parameter.name != "help":
                assert f"- `{parameter.opts[0]}" in page
