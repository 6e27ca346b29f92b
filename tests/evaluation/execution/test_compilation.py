"""Programs are forgotten before a process has no room for more, and warmed up again."""

import jax
import jax.numpy as jnp

from evaluation.execution.compilation import forget_if_many, until_forgotten
from evaluation.execution.trial import Attempt


def test_what_was_warmed_up_is_warmed_up_again_once_programs_are_forgotten():
    calls, traced = [], []

    @jax.jit
    def program(x):
        traced.append(1)
        return x + 1

    @until_forgotten
    def warm_up(name: str) -> None:
        calls.append(name)
        program(jnp.ones(3))

    for name in ("a", "b", "a"):
        warm_up(name)
    assert not forget_if_many(10**9, 1e3, seconds=0.0)
    warm_up("a")
    assert (calls, len(traced)) == (["a", "b"], 1)
    assert forget_if_many(0, seconds=0.0)
    assert not forget_if_many(0)  # counted a moment ago
    warm_up("a")
    assert (calls, len(traced)) == (["a", "b", "a"], 2)
    assert forget_if_many(10**9, 1e-3, seconds=0.0)  # any process is larger than a megabyte


def test_trials_begin_with_it(monkeypatch):
    counted = []
    monkeypatch.setattr("evaluation.execution.trial.forget_if_many", lambda: counted.append(1))
    assert Attempt(lambda seed: {"value": seed}, ("seed",))({"seed": 3})["value"] == 3
    assert counted == [1]
