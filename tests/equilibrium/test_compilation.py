"""Compiled programs agree with the code.

jaxlib 0.8 to 0.10 reads wrong entries of some fused vectors on processors with AVX2 (of a fused
vector of 6 that is cut to 4); the interior-point method then still ends somewhere, only later or
not at all. Here every part of a Newton step is run as compiled for speed, which is what users run,
and as compiled without any optimisation, which is how all other tests are (tests/conftest.py).
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium import SolverOptions
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import evaluate
from foresight_env.equilibrium.linear_algebra.stagewise import StageSystem, factorise, solve_stages
from foresight_env.equilibrium.linear_algebra.transitions import EqualSizes
from foresight_env.equilibrium.newton.interior_point import newton_step
from foresight_env.equilibrium.newton.newton_system import (
    direction,
    eliminate_pairs,
    fischer_burmeister,
    stage_system,
)
from foresight_env.equilibrium.newton.start import begin
from foresight_env.equilibrium.settings import Softness
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting

HORIZONS = (7, 17)
"""Short and long enough for the vectorised loops, whose first step takes 16 stages."""
FAST = {
    "xla_backend_optimization_level": 3,
    "xla_cpu_use_fusion_emitters": True,
    "xla_cpu_parallel_codegen_split_count": 32,
}
"""XLA's defaults."""
PLAIN = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}


def same(function, *arguments):
    """Both results, entry by entry."""
    fast = jax.tree.leaves(jax.jit(function, compiler_options=FAST)(*arguments))
    plain = jax.tree.leaves(jax.jit(function, compiler_options=PLAIN)(*arguments))
    for a, b in zip(fast, plain, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(b).max(initial=0.0)))


@pytest.mark.parametrize(("proximity", "players"), [("soft", 3)])
def test_newton_steps(proximity, players):
    game = crosswalk_game(players, HORIZONS[-1], proximity)
    setting = nominal_setting(players)
    layout, options = layout_of(game), SolverOptions()
    with jax.enable_x64(True):
        parameters = jax.tree.map(
            jnp.asarray,
            check_parameters(game, setting.initial_state, setting.theta, setting.gamma),
        )
        pairs, point = pairs_of(layout), begin(layout, options, parameters, None).point
        exact = zero = jnp.zeros(())

        def evaluated(point):
            return evaluate(layout, pairs, point, parameters, exact, options.barrier)

        same(evaluated, point)
        ev = evaluated(point)
        linear = fischer_burmeister(pairs, point, options.barrier)

        def beside_the_path(point, ev, linear):
            eliminated = eliminate_pairs(layout, pairs, linear, Softness.least)
            factor = factorise(stage_system(layout, point, ev, eliminated), layout.equal_sizes)
            return direction(layout, pairs, ev, factor, eliminated, linear)

        same(beside_the_path, point, ev, linear)

        def stepped(point, ev):
            return newton_step(
                layout, options, pairs, point, ev, options.barrier, None, jnp.ones(()), zero
            )[0]

        same(stepped, point, ev)


@pytest.mark.parametrize(
    ("stages", "sizes"),
    [
        (HORIZONS[0], (4, 3)),
        (HORIZONS[1], (8, 6)),
        (HORIZONS[0], (3, 1)),
        (HORIZONS[1], (12, 9)),
        (HORIZONS[1], (16, 19)),
    ],
)
def test_a_stage_system_is_solved(stages, sizes):
    """The recursion's answer against the equations that it solves."""
    n, m = sizes
    random = np.random.default_rng(n * m)
    a, b = 0.5 * random.normal(size=(stages, n, n)), random.normal(size=(stages, n, m))
    check_stage_system(random, a, b, None)


@pytest.mark.parametrize("players", [2, 3, 4, 7])
def test_a_stage_system_of_equal_players_is_solved(players):
    """Each player's dynamics depend on its own state; small stages and large ones."""
    sizes, stages = EqualSizes(players, 4, 2), HORIZONS[0]
    random = np.random.default_rng(players)
    own = np.eye(players)
    a = np.einsum("ij,tiab->tiajb", own, 0.5 * random.normal(size=(stages, players, 4, 4)))
    b = np.einsum("ij,tiab->tiajb", own, random.normal(size=(stages, players, 4, 2)))
    a, b = a.reshape(stages, 4 * players, -1), b.reshape(stages, 4 * players, -1)
    check_stage_system(random, a, b, sizes)


def check_stage_system(random, a, b, equal_sizes):
    """A random system with these dynamics, solved and put into its equations."""
    stages, n, m = b.shape
    w = n + m
    square = random.normal(size=(stages, w, w))
    hessian = square @ square.transpose(0, 2, 1) + 5.0 * np.eye(w)
    hessian += 0.3 * random.normal(size=hessian.shape)
    curvature = 0.1 * random.normal(size=(stages, w, w))
    rho, r_x = random.uniform(0.3, 1.0, (stages, n)), random.normal(size=(stages, n))
    r_u, defect = random.normal(size=(stages, m)), random.normal(size=(stages, n))
    initial_change = random.normal(size=n)
    with jax.enable_x64(True):
        arguments = jax.tree.map(jnp.asarray, (hessian, curvature, a, b, rho, r_x, r_u, defect))

        def solved(hessian, curvature, a, b, rho, r_x, r_u, defect):
            factor = factorise(StageSystem(hessian, curvature, a, b, rho), equal_sizes)
            return solve_stages(factor, r_x, r_u, defect, jnp.asarray(initial_change))

        fast = jax.jit(solved, compiler_options=FAST)
        dx, du = (np.asarray(v) for v in fast(*arguments))
    before = np.concatenate([initial_change[None], dx[:-1]])
    moved = np.einsum("tij,tj->ti", a, before) + np.einsum("tij,tj->ti", b, du) + defect
    np.testing.assert_allclose(dx, moved, atol=1e-10)
    q, later = np.zeros((stages, n)), np.zeros(n)
    for t in reversed(range(stages)):
        q[t] = hessian[t, :n, :n] @ dx[t] + hessian[t, :n, n:] @ du[t] + r_x[t] + later
        bent = curvature[t, :n, :n] @ before[t] + curvature[t, :n, n:] @ du[t]
        later = rho[t] * (a[t].T @ q[t] + bent)
    felt = np.einsum("tij,tj->ti", hessian[:, n:, :n], dx)
    felt += np.einsum("tij,tj->ti", hessian[:, n:, n:], du)
    felt += np.einsum("tji,tj->ti", b, q) + r_u
    felt += np.einsum("tij,tj->ti", curvature[:, n:, :n], before)
    felt += np.einsum("tij,tj->ti", curvature[:, n:, n:], du)
    np.testing.assert_allclose(felt, 0.0, atol=1e-7)
