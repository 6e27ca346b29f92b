"""Reports: pages, tables, figures."""

from foresight_env.extras import require

require("evaluation", "evaluation.reports")
