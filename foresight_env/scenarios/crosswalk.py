"""Crosswalk."""
from foresight_env.games import *
