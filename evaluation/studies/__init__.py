"""Studies: configured sets of trials and their rows."""

from foresight_env.extras import require

require("evaluation", "evaluation.studies", "pyarrow", "rich")
