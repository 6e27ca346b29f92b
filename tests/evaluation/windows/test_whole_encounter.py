"""Discount factors of whole encounters, from a table whose truth is known."""

import pytest

from evaluation.windows.encounters import EncounterError
from evaluation.windows.whole_encounter import fit_whole_encounters
from foresight_env.datasets import Recording
from tests.support.made_walkers import COLLISION_WEIGHT, GAMMAS, NOISE, RATE, walker_rows


def recorded(rows):
    names = ("time", "agent", "x", "y")
    table = dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))
    return Recording.from_dataframe(table, rate=RATE)


@pytest.fixture(scope="module")
def walkers():
    return recorded(walker_rows())


def test_known_discount_factors_are_found(walkers):
    (fit,) = fit_whole_encounters(walkers, collision_weight=COLLISION_WEIGHT)
    assert fit.estimate.gamma_identifiable.all()
    assert fit.noise_std == pytest.approx(NOISE, rel=0.2)
    for agent, gamma, (low, high) in zip(
        fit.agents, fit.estimate.gamma, fit.estimate.gamma_interval, strict=True
    ):
        assert gamma == pytest.approx(GAMMAS[agent], abs=0.1)
        assert low < GAMMAS[agent] < high < low + 0.3
    # A wrong weight explains the positions less well.
    (mild,) = fit_whole_encounters(walkers, agents=("ann", "bob"))
    assert mild.noise_std > 1.3 * fit.noise_std


def test_encounters_that_cannot_be_fitted(walkers):
    with pytest.raises(EncounterError, match="has no agent 'eve'"):
        fit_whole_encounters(walkers, agents=("ann", "eve"))
    with pytest.raises(ValueError, match="collision_weight: is 0; expected a positive"):
        fit_whole_encounters(walkers, collision_weight=0)
    short = recorded([row for row in walker_rows() if 1.3 < row[0] < 3.3])
    with pytest.raises(EncounterError, match=r"positions 0\.2 s apart around the crossing"):
        fit_whole_encounters(short, agents=("ann", "bob"))
