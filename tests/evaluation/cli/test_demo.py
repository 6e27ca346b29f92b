"""Sentences of the demo's summary, from rows made by hand."""

import pytest

from evaluation.cli.demo import (
    EGOS,
    OBSERVED_SECONDS,
    SEEDS,
    SETTING,
    accuracy_sentence,
    crowd_sentence,
    recorded_sentence,
)
from evaluation.samples.recording import (
    COLLISION_WEIGHT,
    driven_pairs,
    made_recording,
    true_gammas,
)
from evaluation.studies import estimation
from evaluation.windows.partial_encounter import predict_encounters


def test_recorded_data():
    pair = driven_pairs()[0]
    found = predict_encounters(
        made_recording(), OBSERVED_SECONDS, agents=pair, collision_weight=COLLISION_WEIGHT
    )
    told = recorded_sentence(found, true_gammas())
    assert told.startswith("Recorded data: 2 of 2 discount factors lie in their 90 % intervals")
    for name, error in found[0].average_errors.items():
        assert f"{error:.2f} m ({name})" in told
    outside = {**true_gammas(), pair[0]: 0.99}
    assert recorded_sentence(found, outside).startswith("Recorded data: 1 of 2")


def test_crowd():
    def rows(harmed):
        return [
            {
                "setting": SETTING, "ego": ego, "seed": seed, "cost": 10.0 + k + (-1) ** seed,
                "ended": "collision" if ego == harmed and seed == 0 else "goal reached",
                "error": None,
            }
            for k, ego in enumerate(EGOS)
            for seed in SEEDS
        ]  # fmt: skip

    told = crowd_sentence(rows(None), rows("assume-gamma-1"))
    assert "(0 of 32 episodes with a collision) an episode costs 10.0 (oracle), 11.0" in told
    assert "collide in 0 (oracle), 0 (infer-gamma), 1 (assume-gamma-1) and 0 (c" in told


def test_accuracy_leaves_failed_trials_out():
    limit = estimation.bound("full") * 0.05**2
    rows = [
        {"method": method, "std": std, "error_squared": factor * limit, "error": None}
        for method, factor in zip(estimation.METHODS, (1.1, 2.0), strict=True)
        for std in (0.0, 0.05, 0.1)
    ]
    failed = {"method": "infer-gamma", "std": 0.01, "error": "ValueError"}
    told = accuracy_sentence([*rows, failed])
    first, second = estimation.METHODS
    assert "noise of 0.05 (std" in told
    assert f"1.1 ({first}) and 2.0 ({second}) times" in told


@pytest.mark.parametrize("ego", EGOS)
def test_egos_are_registered(ego):
    from agents import make_ego

    assert make_ego(ego).name == ego
