"""A phase step by step, by hand: the drivers `solve` and `solve_many` do the same."""

from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import Budget, SolverOptions, Status, solve, solve_many
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.newton.phase import (
    accuracy_of,
    init_phase,
    phase_ended,
    step_phase,
    succeeded,
)
from foresight_env.equilibrium.newton.schedule import phase_rules
from foresight_env.equilibrium.newton.start import begin, begin_phase
from foresight_env.equilibrium.settings import Damping
from tests.support.small_games import CROSSING_GAMMA, CROSSING_STATES, crossing, crossing_theta

OPTIONS = SolverOptions()


@lru_cache
def by_hand():
    """States of the first phase from a cold start, the first one before any step."""
    layout = layout_of(crossing())
    with jax.enable_x64(True):
        parameters = check_parameters(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
        parameters = jax.tree.map(jnp.asarray, parameters)
        accuracy, number = accuracy_of(OPTIONS, None), jnp.asarray(1)
        rules = phase_rules(layout, OPTIONS, number, None, None)
        start = begin(layout, OPTIONS, parameters, None)
        point = begin_phase(layout, OPTIONS, parameters, start, number)
        step = jax.jit(partial(step_phase, layout, OPTIONS))
        states = [init_phase(layout, parameters, point, rules, accuracy)]
        while not phase_ended(layout, OPTIONS, states[-1], rules, accuracy):
            states.append(step(parameters, states[-1], rules, accuracy))
        assert succeeded(states[-1], accuracy)
        return [jax.tree.map(np.asarray, state) for state in states]


def test_the_phase_by_hand_is_what_solve_reports():
    state = by_hand()[-1]
    found = solve(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
    assert found.status == Status.SOLVED
    assert found.iterations == state.iteration == len(by_hand()) - 1 > 3
    for hand, reported in zip(state.point, found.point, strict=True):
        np.testing.assert_allclose(hand, reported, atol=1e-9)
    largest = max(state.evaluation.error, state.evaluation.complementarity)
    np.testing.assert_allclose(found.residual, largest, atol=1e-12)


@pytest.mark.parametrize("steps", [1, 2, 5, 9])
def test_every_iterate_is_that_of_solve(steps):
    state = by_hand()[steps]
    budget = Budget(phases=1, newton_steps=steps)
    found = solve(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA, budget=budget)
    assert found.iterations == state.iteration == steps
    assert found.status == Status.ITERATION_LIMIT
    for hand, reported in zip(state.point, found.point, strict=True):
        np.testing.assert_allclose(hand, reported, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("batch_size", [1, 2, 3])
def test_batch_slots_do_the_same_steps(batch_size):
    """The second game has other steps, so that slots change games at different times."""
    states = np.stack([CROSSING_STATES, CROSSING_STATES + 0.1, CROSSING_STATES])
    states[1, :, 2:] = CROSSING_STATES[:, 2:]
    gamma = np.stack([CROSSING_GAMMA, [0.3, 1.0], CROSSING_GAMMA])
    found = solve_many(
        crossing(), states, crossing_theta(), gamma, batch_size=batch_size, threads=1
    )
    last = by_hand()[-1]
    assert found.iterations[0] == found.iterations[2] == last.iteration
    assert found.iterations[1] != last.iteration
    for k in (0, 2):
        for hand, reported in zip(last.point, found.point, strict=True):
            np.testing.assert_allclose(reported[k], hand, atol=1e-9)


def test_what_ends_a_phase():
    layout = layout_of(crossing())
    with jax.enable_x64(True):
        accuracy = accuracy_of(OPTIONS, None)
        rules = phase_rules(layout, OPTIONS, jnp.asarray(1), None, None)
        first, last = (jax.tree.map(jnp.asarray, by_hand()[k]) for k in (0, -1))
        assert not phase_ended(layout, OPTIONS, first, rules, accuracy)
        solved = last._replace(iteration=jnp.asarray(0))
        assert phase_ended(layout, OPTIONS, solved, rules, accuracy)
        used_up = first._replace(iteration=rules.steps)
        assert phase_ended(layout, OPTIONS, used_up, rules, accuracy)
        overflowed = first._replace(finite=jnp.asarray(False))
        assert phase_ended(layout, OPTIONS, overflowed, rules, accuracy)
        assert not succeeded(overflowed, accuracy)
        most = jnp.asarray(OPTIONS.damping.most)
        damped = first._replace(damped=first.damped._replace(value=most))
        assert phase_ended(layout, OPTIONS, damped, rules, accuracy)
        assert jnp.isfinite(damped.error)


def test_a_step_that_raises_the_residual_far_is_undone_and_damped():
    """Whatever raises the residual counts as far where the factor is nearly 0."""
    layout = layout_of(crossing())
    strict = SolverOptions(damping=Damping(raised=1e-12))
    with jax.enable_x64(True):
        parameters = check_parameters(crossing(), CROSSING_STATES, crossing_theta(), CROSSING_GAMMA)
        parameters = jax.tree.map(jnp.asarray, parameters)
        accuracy = accuracy_of(strict, None)
        rules = phase_rules(layout, strict, jnp.asarray(1), None, None)
        before = jax.tree.map(jnp.asarray, by_hand()[2])
        step = jax.jit(partial(step_phase, layout, strict))
        once = step(parameters, before, rules, accuracy)
        twice = step(parameters, once, rules, accuracy)
        for state in (once, twice):
            for new, old in zip(state.point, before.point, strict=True):
                np.testing.assert_array_equal(new, old)
            assert state.evaluation.error == before.evaluation.error
            assert state.finite
        assert (once.damped.value, twice.damped.value) == (1.0, 10.0)
        assert twice.iteration == before.iteration + 2
    # Never accepting a step ends a phase before its steps are used up, and nothing has diverged.
    budget = Budget(phases=1)
    found = solve(
        crossing(),
        CROSSING_STATES,
        crossing_theta(),
        CROSSING_GAMMA,
        options=strict,
        budget=budget,
    )
    assert found.iterations == 7  # damping of 1, 10, ..., 1e6
    assert found.status == Status.ITERATION_LIMIT
