"""Training data and training of learned agents."""

from foresight_env.extras import require

require("evaluation", "evaluation.training")
