"""The command line."""

from foresight_env.extras import require

require("evaluation", "evaluation.cli")
