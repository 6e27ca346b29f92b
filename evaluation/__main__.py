"""`python -m evaluation` is the command `foresight`."""

from evaluation.command_line import main

main()
