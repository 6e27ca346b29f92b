"""Programs of a first estimate are compiled side by side, each once."""

import threading
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env import compilation
from foresight_env.equilibrium import solve
from foresight_env.equilibrium.conditions import residual
from foresight_env.games.observations import full_state
from foresight_env.inverse import Free, GaussNewton, MultiStart, estimate
from foresight_env.scenarios.crosswalk import MONTE_CARLO, crosswalk_game

PROGRAMS = {"jit(_tracked)", "jit(search)", "jit(_finish)"}
HORIZON = 6


def fit(game, found, **settings):
    return estimate(
        game,
        np.concatenate(found.states, axis=1)[:4],
        full_state(game.state_sizes),
        initial_state=MONTE_CARLO.initial_state,
        theta=MONTE_CARLO.theta,
        gamma=[0.8, 0.8],
        free=Free(gamma=True, theta=()),
        method=GaussNewton(2),
        starts=MultiStart(1),
        **settings,
    )


def test_a_first_estimate_compiles_each_program_once_and_a_second_none(monkeypatch):
    compiled, traced = [], []
    original = residual.linearise

    def linearise(*arguments):
        traced.append(arguments)
        return original(*arguments)

    def listen(event, duration_secs, **details):
        if event.endswith("backend_compile_duration") and details.get("fun_name") in PROGRAMS:
            compiled.append((details["fun_name"], threading.get_ident()))

    game = crosswalk_game(2, HORIZON)
    found = solve(game, MONTE_CARLO.initial_state, MONTE_CARLO.theta, [0.8, 0.8])
    jax.clear_caches()
    compilation._first_times.clear()
    monkeypatch.setattr(residual, "linearise", linearise)
    jax.monitoring.register_event_duration_secs_listener(listen)
    threads = threading.active_count()
    first = fit(game, found)
    assert Counter(name for name, _ in compiled) == dict.fromkeys(PROGRAMS, 1)
    of = {name: thread for name, thread in compiled}
    assert of["jit(search)"] != of["jit(_tracked)"] == threading.get_ident()
    assert len(traced) == 2  # by the solver of the tracking start, and by that of the game
    again = fit(game, found)
    warm = fit(game, found, initial_guess=found)
    assert len(compiled) == len(PROGRAMS)
    assert threading.active_count() == threads
    assert first.num_forward_solves == again.num_forward_solves
    np.testing.assert_array_equal(first.values, again.values)
    assert warm.status == 0


def test_a_failed_compilation_is_raised_and_tried_again():
    class Failing(jax.stages.Lowered):
        def __init__(self):
            pass

        def compile(self):
            assert jax.config.jax_enable_x64
            raise RuntimeError("no memory")

    with pytest.raises(RuntimeError, match="no memory"), compilation.compiling(Failing()):
        pass
    with pytest.raises(ZeroDivisionError), compilation.compiling(Failing()):
        1 / 0  # noqa: B018
    key = object()
    with pytest.raises(ZeroDivisionError), compilation.first_time(key):
        1 / 0  # noqa: B018
    for new in (True, False):
        with compilation.first_time(key) as first:
            assert first == new


def test_a_thread_waits_for_another_ones_compilation():
    key, seen = object(), []

    def second():
        with compilation.first_time(key) as first:
            seen.append(first)

    with compilation.first_time(key):
        thread = threading.Thread(target=second)
        thread.start()
        thread.join(0.05)
        assert not seen
    thread.join()
    assert seen == [False]


def test_signatures_tell_programs_apart():
    a, b = np.zeros((2, 3)), jnp.zeros((2, 3))
    assert compilation.signature((a, 1.0)) == compilation.signature((a + 1.0, 2.0))
    assert compilation.signature(a) != compilation.signature(a[:1])
    assert compilation.signature(a) != compilation.signature(b)  # single precision
    assert compilation.signature((a,)) != compilation.signature([a])
