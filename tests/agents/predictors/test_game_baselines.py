"""The baselines that infer from the game: residuals of its conditions, and particles."""

import numpy as np
import pytest

from agents import History
from agents.predictors.encounter_fit import EncounterBelief
from agents.predictors.kkt_residual import KktResidualPredictor, _conditions
from agents.predictors.particle_filter import ParticleFilterPredictor
from foresight_env.equilibrium import Status, solve
from foresight_env.scenarios.encounter import encounter_game, player_theta

DT = 0.3
HORIZON = 12
KINDS = ("pedestrian", "car")
WISHES = ((0.0, 1.3), (4.0, 0.0))
OPEN = EncounterBelief(speed_deviation=2.0, walking_gamma=(0.6, 2.0))
"""Little is believed before anything is seen."""
PREDICTORS = (
    KktResidualPredictor(belief=OPEN),
    ParticleFilterPredictor(belief=OPEN, particles=128, noise_std=0.02),
)


@pytest.fixture(scope="module")
def played():
    """Somebody walks across a car's way: the states, for given discount factors."""

    def path(gamma):
        game = encounter_game(KINDS, HORIZON, DT)
        start = np.array([[0.0, -4.0, *WISHES[0]], [-9.0, 0.0, *WISHES[1]]])
        theta = [player_theta(k, np.array(w)) for k, w in zip(KINDS, WISHES, strict=True)]
        solution = solve(game, list(start), theta, np.array(gamma))
        assert int(solution.status) == Status.SOLVED
        return np.stack([np.asarray(s) for s in solution.states], axis=1)

    return path


@pytest.mark.parametrize("agent", [0, 1])
def test_the_residual_vanishes_at_the_truth_alone(played, agent):
    """At an equilibrium some costate explains every control, for the true parameters only."""
    gamma = (0.5, 0.9)
    states = played(gamma)

    def least(value, preferred):
        shape = (KINDS, DT, agent, states)
        start, rates = _conditions(*shape, np.array([value, *preferred, 0.0, 0.0, 0.0, 0.0]))
        costate = np.linalg.lstsq(np.asarray(rates)[:, 3:], -np.asarray(start), rcond=None)[0]
        return float(np.linalg.norm(start + np.asarray(rates)[:, 3:] @ costate))

    own = np.array(WISHES[agent])
    assert least(gamma[agent], own) < 1e-5
    assert least(gamma[agent] - 0.2, own) > 1e-3
    assert least(gamma[agent], own + np.array([0.2, 0.2])) > 1e-3


def history(states):
    """The first steps of a path, as predictors are shown them."""
    headings = np.full(states.shape[:2], np.nan)
    return History(states, headings, KINDS, np.full((2, 2), 0.5), DT)


@pytest.mark.parametrize("predictor", PREDICTORS, ids=lambda p: p.name)
def test_more_foresight_is_seen_as_more(predictor, played):
    """The order of two discount factors, and where somebody of little foresight walks."""
    near, far = (
        predictor.predict(history(played((value, 0.9))[:9]), HORIZON - 8) for value in (0.2, 1.0)
    )
    assert not near.fallback
    assert not far.fallback
    assert near.gamma[0] < far.gamma[0] - 0.1
    truth = played((0.2, 0.9))[9:, 0, :2]
    assert np.linalg.norm(near.most_likely[:, 0] - truth, axis=1).max() < 0.02
