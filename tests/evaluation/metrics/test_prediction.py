"""Metrics of forecasts, by hand."""

from dataclasses import replace

import numpy as np
import pytest

from agents.interfaces.predictor import Forecast, History, single
from evaluation.metrics.prediction import _motions, footprint, judged, overlaps
from evaluation.windows.interaction import cut
from foresight_env.games.footprints import least_gap
from tests.support.made_crossings import two_people


def still(places, kinds, velocity=(0.0, 0.0)):
    states = np.zeros((2, len(kinds), 4))
    states[..., :2] = places
    states[..., 2:] = velocity
    return History(
        states, np.full((2, len(kinds)), np.nan), kinds, np.full((len(kinds), 2), np.nan), 0.4
    )


def test_overlaps_along_the_step():
    """Two people who change places in one step pass through each other."""
    history = still([[-1.0, 0.0], [1.0, 0.0]], ("pedestrian",) * 2)
    swapped = np.array([[[1.0, 0.0], [-1.0, 0.0]]])
    assert overlaps(history, swapped) == 1
    assert overlaps(history, history.states[-1:, :, :2]) == 0
    assert overlaps(history, np.full((1, 2, 2), np.nan)) == 0


@pytest.mark.parametrize("seed", range(5))
def test_no_overlap_is_missed(seed):
    """Crowded random walks against every pair and step, none left out for being far."""
    random = np.random.default_rng(seed)
    kinds = ("pedestrian", "car", "bicycle", "pedestrian")
    history = still(random.uniform(-3.0, 3.0, (4, 2)), kinds)
    path = history.states[-1, :, :2] + np.cumsum(random.normal(size=(6, 4, 2)), axis=0)
    shapes = [footprint(k, e) for k, e in zip(history.kinds, history.extents, strict=True)]
    tracks = [_motions(history, i, path[:, i]) for i in range(4)]
    expected = sum(
        any(
            least_gap(shapes[i], shapes[j], a, b) < 0.0
            for a, b in zip(tracks[i], tracks[j], strict=True)
        )
        for i in range(4)
        for j in range(i)
    )
    assert overlaps(history, path) == expected


def test_vehicles_are_boxes():
    """A person 1.5 m from a car's middle is clear at its side, not in front of it."""
    history = still([[0.0, 0.0], [0.0, 1.5]], ("car", "pedestrian"), (1.0, 0.0))
    assert overlaps(history, history.states[-1:, :, :2]) == 0
    history = still([[0.0, 0.0], [1.5, 0.0]], ("car", "pedestrian"), (1.0, 0.0))
    assert overlaps(history, history.states[-1:, :, :2]) == 1
    # Its stated size counts where there is one.
    small = replace(history, extents=np.array([[1.0, 1.0], [np.nan, np.nan]]))
    assert overlaps(small, small.states[-1:, :, :2]) == 0


def test_a_perfect_forecast_and_a_shifted_one():
    window = cut(two_people(), ("1", "2"), 120)
    perfect = judged(window.history, window.truth, single(window.truth))
    assert perfect["average_error"] == perfect["fde_4"] == perfect["missed"] == 0
    assert perfect["overlaps"] == perfect["overlaps_recorded"]
    off = judged(window.history, window.truth, single(window.truth + np.array([3.0, 0.0])))
    for name in ("average_error", "ade_1", "ade_4", "fde_2", "fde_4"):
        assert off[name] == pytest.approx(3.0)
    assert off["agent_errors"] == pytest.approx([3.0, 3.0])
    assert off["missed"] == 2
    assert perfect["nll"] is perfect["levels"] is None  # it says nothing of chances


def test_the_best_of_several_futures_and_their_chances():
    window = cut(two_people(), ("1", "2"), 120)
    shifted = window.truth + np.array([3.0, 0.0])
    both, chances = np.stack([shifted, window.truth]), np.array([0.75, 0.25])
    spread = np.full((*both.shape, 2), 0.0) + 0.25 * np.eye(2)
    row = judged(window.history, window.truth, Forecast(both, chances, spread))
    assert row["average_error"] == pytest.approx(3.0)
    assert row["best_average_error"] == row["best_final_error"] == 0.0
    surer = judged(window.history, window.truth, Forecast(both, chances[::-1], spread))
    assert surer["average_error"] == 0.0
    assert surer["nll"] < row["nll"]
    assert sum(row["levels"]) == window.present.sum()
