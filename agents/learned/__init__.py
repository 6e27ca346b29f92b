"""Learned predictors: networks, their training, and their weights. Needs the extra `learned`."""

from foresight_env.extras import require

require("learned", "agents.learned")
