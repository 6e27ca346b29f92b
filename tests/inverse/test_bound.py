"""The Cramer-Rao bound: by its definition, and where there is none."""

import numpy as np
import pytest

from foresight_env.equilibrium import solve
from foresight_env.games import full_state, positions
from foresight_env.inverse import Free, cramer_rao
from tests.support.small_games import CROSSING_GAMMA, CROSSING_STATES, crossing, crossing_theta

FREE = Free(("goal",), True, False)


def bound(model=None, free=FREE, count=None):
    return cramer_rao(
        crossing(),
        model or full_state((4, 4)),
        initial_state=CROSSING_STATES,
        theta=crossing_theta(),
        gamma=CROSSING_GAMMA,
        free=free,
        count=count,
    )


def test_it_is_the_inverse_information_by_central_differences():
    found = bound()
    step = 1e-4
    columns = []
    for i in range(2):
        for k in range(3):
            ends = []
            for sign in (1.0, -1.0):
                theta = [dict(t) for t in crossing_theta()]
                gamma = np.array(CROSSING_GAMMA, dtype=float)
                if k < 2:
                    theta[i]["goal"] = np.array(theta[i]["goal"], dtype=float)
                    theta[i]["goal"][k] += sign * step
                else:
                    gamma[i] += sign * step
                played = solve(crossing(), CROSSING_STATES, theta, gamma, throw=True)
                ends.append(np.concatenate(played.states, axis=1).ravel())
            columns.append((ends[0] - ends[1]) / (2.0 * step))
    jacobian = np.stack(columns, axis=1)
    expected = np.linalg.inv(jacobian.T @ jacobian)
    assert tuple(map(str, found.parameters[:3])) == ("goal[0] of 0", "goal[1] of 0", "gamma of 0")
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-3, atol=1e-6)
    # Everything observed: an efficient estimator loses one noise variance per parameter.
    np.testing.assert_allclose(found.trajectory, 6.0, rtol=1e-6)


def test_what_observations_leave_open_has_no_bound():
    # The first observation alone says nothing about goals and discount factors.
    found = bound(positions((4, 4)), Free(("goal",), True, True), count=1)
    names = np.array([str(parameter) for parameter in found.parameters])
    seen = np.isin(names, [f"initial_state[{k}] of {i}" for i in range(2) for k in range(2)])
    variances = np.diag(found.covariance)
    np.testing.assert_allclose(variances[seen], 1.0)
    assert np.isinf(variances[~seen]).all()
    assert np.isinf(found.trajectory)


def test_bad_arguments_are_named():
    with pytest.raises(ValueError, match="free: nothing is free"):
        bound(free=Free((), False, False))
    for count in (0, 10):
        with pytest.raises(ValueError, match=f"count: is {count}; expected 1 to 9"):
            bound(count=count)
