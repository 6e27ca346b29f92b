"""Settings of the solver and the estimator: the benchmark of sensitivity varies them."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import pytest

from benchmarks import sensitivity
from foresight_env.equilibrium import SolverOptions
from foresight_env.equilibrium.settings import CentralPath, Softness, VerificationSettings
from foresight_env.inverse import Posterior, Profile
from foresight_env.inverse.settings import EstimatorSettings, SampleSettings, WalkSettings


def paths(settings: Any, above: str = "") -> Iterator[str]:
    """Dotted paths of all numbers."""
    for field in fields(settings):
        value, path = getattr(settings, field.name), f"{above}{field.name}"
        if is_dataclass(value):
            yield from paths(value, f"{path}.")
        else:
            yield path


OF_SOLVER = (
    sensitivity.SOLVER
    | sensitivity.NONLINEAR
    | sensitivity.WARM
    | sensitivity.DERIVATIVES
    | sensitivity.SMOOTHED
)


@pytest.mark.parametrize(
    ("settings", "varied"),
    [
        (SolverOptions(), OF_SOLVER),
        (VerificationSettings(), sensitivity.VERIFICATION),
        (EstimatorSettings(), sensitivity.ESTIMATOR),
        (Profile(), sensitivity.PROFILE),
        (Posterior(), sensitivity.POSTERIOR),
    ],
)
def test_values_that_are_tried_lie_on_both_sides_of_the_default(settings, varied):
    for path, (low, high) in varied.items():
        assert low < sensitivity.value_of(settings, path) < high, path
        changed = sensitivity.with_value(settings, path, high)
        assert sensitivity.value_of(changed, path) == high
        assert changed != settings


@pytest.mark.parametrize(
    ("settings", "above", "varied"),
    [
        (Softness(), "softness.", OF_SOLVER),
        (CentralPath(), "path.", OF_SOLVER),
        (VerificationSettings(), "", sensitivity.VERIFICATION),
        (EstimatorSettings(), "", sensitivity.ESTIMATOR),
        (WalkSettings(), "walk.", sensitivity.PROFILE),
        (SampleSettings(), "sampling.", sensitivity.POSTERIOR),
    ],
)
def test_every_setting_is_varied(settings, above, varied):
    assert set(paths(settings, above)) <= set(varied)
