"""`python -m evaluation` is the command `foresight`."""

from evaluation.cli.app import main

main()
