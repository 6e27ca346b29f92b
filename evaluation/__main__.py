"""The command `foresight`; also `python -m evaluation`."""

from __future__ import annotations

import sys

from foresight_env.extras import MissingExtraError, require


def main() -> None:
    """Run the command; without the extra `evaluation`, print one line and exit with status 2."""
    try:
        require("evaluation", "foresight")
    except MissingExtraError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    from evaluation.cli.app import main as run

    run()


if __name__ == "__main__":
    main()
