"""Checks of a user's values whose limits depend on the world."""

from dataclasses import replace

import numpy as np
import pytest

from foresight_env.envs import crosswalk_v0
from foresight_env.envs.core.checks import check_options
from foresight_env.games import Hyperbolic

WORLD = crosswalk_v0.parallel_env(planning_horizon=4).world


def hyperbolic(horizon):
    game = WORLD.game(horizon)
    return replace(game, players=tuple(replace(p, discounting=Hyperbolic()) for p in game.players))


def test_gamma_lies_within_the_limits_of_the_discounting():
    gamma = np.array([0.5, 1.2])
    assert np.array_equal(check_options({"gamma": gamma}, WORLD)["gamma"], gamma)
    with pytest.raises(ValueError, match=r"options\['gamma'\]\[1\]: is -0.1.*Exponential"):
        check_options({"gamma": [0.5, -0.1]}, WORLD)
    other = replace(WORLD, game=hyperbolic)
    with pytest.raises(ValueError, match=r"options\['gamma'\]\[1\]: is 1.2.*0.001 to 1"):
        check_options({"gamma": gamma}, other)
    drawn = WORLD.draw(np.random.default_rng(0))._replace(gamma=gamma)
    with pytest.raises(ValueError, match=r"episode_parameters'\].gamma\[1\]: is 1.2"):
        check_options({"episode_parameters": drawn}, other)
