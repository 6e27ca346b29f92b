"""`python -m evaluation` is the command `foresight`."""

from evaluation.command_line import app

app(prog_name="foresight")
