"""Prediction windows from recordings and simulations."""

from foresight_env.extras import require

require("evaluation", "evaluation.windows", "pyarrow")
