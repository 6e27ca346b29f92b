"""Three designs for Newton's linear system: a recursion over stages, controls only, one sparse LU.

The library uses the first. *Controls only* condenses the states out of the system, which leaves one
dense matrix for all stages; what does not change during a solve (how states follow controls) is
computed beforehand and not counted. *One sparse LU* hands states, controls and costates of all
stages to SuperLU, without the time that assembling the matrix takes.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import sparse
from scipy.sparse.linalg import splu

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick, median_seconds
from foresight_env.equilibrium import SolverOptions
from foresight_env.equilibrium.checks.validation import check_parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import evaluate
from foresight_env.equilibrium.linear_algebra.stagewise import StageSystem, factorise, solve_stages
from foresight_env.equilibrium.newton.newton_system import (
    eliminate_pairs,
    on_the_path,
    stage_system,
)
from foresight_env.equilibrium.newton.start import begin
from foresight_env.equilibrium.settings import Softness
from foresight_env.scenarios.crosswalk import crosswalk_game, nominal_setting

SIZES = ((2, 10), (2, 25), (2, 50), (4, 10), (4, 25))
"""Players and horizons."""
REPEATS = 50
"""Systems solved one after the other within one compiled program."""


class LinearSystem:
    """The first linear system of a crosswalk's cold start, with a right-hand side."""

    def __init__(self, players: int, horizon: int) -> None:
        game, setting = crosswalk_game(players, horizon), nominal_setting(players)
        layout, options = layout_of(game), SolverOptions()
        parameters = jax.tree.map(
            jnp.asarray,
            check_parameters(game, setting.initial_state, setting.theta, setting.gamma),
        )
        pairs, point = pairs_of(layout), begin(layout, options, parameters, None).point
        ev = evaluate(layout, pairs, point, parameters, jnp.ones(()), options.barrier)
        eliminated = eliminate_pairs(
            layout, pairs, on_the_path(pairs, point, jnp.zeros(())), Softness.least
        )
        self.system: StageSystem = stage_system(layout, point, ev, eliminated)
        self.sizes = layout.equal_sizes
        self.n, self.m = self.system.b.shape[1:]
        random = np.random.default_rng(0)
        self.r_x, self.r_u, self.defect = (
            jnp.asarray(random.normal(size=(horizon, size))) for size in (self.n, self.m, self.n)
        )


def by_stages(problem: LinearSystem, hessian: Float[Array, "T w w"]) -> Float[Array, "T m"]:
    """The library's recursion."""
    factor = factorise(problem.system._replace(hessian=hessian), problem.sizes)
    rest = (problem.r_x, problem.r_u, problem.defect, jnp.zeros(problem.n))
    return solve_stages(factor, *rest)[1]


def responses(a: np.ndarray, b: np.ndarray, before: np.ndarray) -> Float[np.ndarray, "Tn Tm"]:
    """Block (s, t): what `du_t` does to `dx_{s+1}`; `before` multiplies what goes into `A_s`."""
    horizon, n, m = b.shape
    out = np.zeros((horizon, n, horizon, m))
    for t in range(horizon):
        out[t, :, t] = b[t]
        for s in range(t + 1, horizon):
            out[s, :, t] = a[s] @ (before[s][:, None] * out[s - 1, :, t])
    return out.reshape(horizon * n, horizon * m)


def free_motion(a: np.ndarray, defect: np.ndarray) -> Float[np.ndarray, "T n"]:
    """States without controls."""
    out, state = np.zeros_like(defect), np.zeros(defect.shape[1])
    for t in range(len(defect)):
        state = a[t] @ state + defect[t]
        out[t] = state
    return out


def condensed(problem: LinearSystem) -> Any:
    """The function of the Hessian that solves for controls alone."""
    system, n = problem.system, problem.n
    a, b, rho = (np.asarray(v) for v in (system.a, system.b, system.rho))
    horizon, _, m = b.shape
    follow = jnp.asarray(responses(a, b, np.ones_like(rho)))
    felt = jnp.asarray(responses(a, b, rho))  # what costates carry back, transposed
    drift = jnp.asarray(free_motion(a, np.asarray(problem.defect)))

    def solve(hessian: Float[Array, "T w w"]) -> Float[Array, "T m"]:
        hxx, hxu = hessian[:, :n, :n], hessian[:, :n, n:]
        hux, huu = hessian[:, n:, :n], hessian[:, n:, n:]
        stages = follow.reshape(horizon, n, horizon * m)
        pushed = jnp.einsum("tij,tjk->tik", hxx, stages)
        own = jnp.arange(horizon)
        pushed = pushed.reshape(horizon, n, horizon, m).at[own, :, own].add(hxu)
        matrix = felt.T @ pushed.reshape(horizon * n, horizon * m)
        matrix = matrix + jnp.einsum("tij,tjk->tik", hux, stages).reshape(matrix.shape)
        matrix = matrix.reshape(horizon, m, horizon, m).at[own, :, own].add(huu)
        known = jnp.einsum("tij,tj->ti", hxx, drift) + problem.r_x
        rest = felt.T @ known.ravel() + problem.r_u.ravel()
        rest = rest + jnp.einsum("tij,tj->ti", hux, drift).ravel()
        size = horizon * m
        return -jnp.linalg.solve(matrix.reshape(size, size), rest).reshape(horizon, m)

    return solve


def sparse_matrix(problem: LinearSystem) -> tuple[sparse.csc_matrix, np.ndarray]:
    """All conditions of all stages, unknowns stage by stage: `dx_{t+1}, du_t, dq_t`."""
    system, n, m = problem.system, problem.n, problem.m
    hessian, a, b, rho = (np.asarray(v) for v in (system.hessian, system.a, system.b, system.rho))
    horizon, size = len(a), 2 * n + m
    matrix = sparse.lil_matrix((horizon * size, horizon * size))
    x, u, q = slice(0, n), slice(n, n + m), slice(n + m, size)

    def put(t: int, row: slice, s: int, column: slice, block: np.ndarray) -> None:
        matrix[
            t * size + row.start : t * size + row.stop,
            s * size + column.start : s * size + column.stop,
        ] = block

    for t in range(horizon):
        put(t, x, t, x, hessian[t, :n, :n])
        put(t, x, t, u, hessian[t, :n, n:])
        put(t, x, t, q, -np.eye(n))
        put(t, u, t, x, hessian[t, n:, :n])
        put(t, u, t, u, hessian[t, n:, n:])
        put(t, u, t, q, b[t].T)
        put(t, q, t, x, np.eye(n))
        put(t, q, t, u, -b[t])
        if t + 1 < horizon:
            put(t, x, t + 1, q, rho[t + 1][:, None] * a[t + 1].T)
            put(t + 1, q, t, x, -a[t + 1])
    parts = (-problem.r_x, -problem.r_u, problem.defect)
    rest = np.concatenate([np.asarray(v) for v in parts], axis=1)
    return matrix.tocsc(), rest.ravel()


def seconds_each(solve: Any, hessian: Float[Array, "T w w"]) -> float:
    """Per system, many within one program, each waiting for the one before."""

    def body(_: int, carried: Array) -> Array:
        return carried + 1e-300 * jnp.sum(solve(hessian + carried))

    program = jax.jit(lambda start: jax.lax.fori_loop(0, REPEATS, body, start))
    zero = jnp.zeros(())
    jax.block_until_ready(program(zero))
    return median_seconds(lambda: jax.block_until_ready(program(zero)), 7) / REPEATS


def measure(players: int, horizon: int) -> tuple[float, float, float]:
    """Seconds per system of the three designs, after checking that they agree."""
    with jax.enable_x64(True):
        problem = LinearSystem(players, horizon)
        designs = (lambda h: by_stages(problem, h), condensed(problem))
        hessian = problem.system.hessian
        matrix, rest = sparse_matrix(problem)
        size = 2 * problem.n + problem.m
        expected = splu(matrix).solve(rest).reshape(horizon, size)
        expected = expected[:, problem.n : problem.n + problem.m]
        for design in designs:
            np.testing.assert_allclose(jax.jit(design)(hessian), expected, rtol=1e-6, atol=1e-6)
        stages, controls = (seconds_each(design, hessian) for design in designs)
        return stages, controls, median_seconds(lambda: splu(matrix).solve(rest), 15)


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` leaves out the larger games."""
    yardstick = Yardstick.measure()
    rows: list[TableRow] = []
    for players, horizon in SIZES[:2] if arguments.quick else SIZES:
        stages, controls, one = measure(players, horizon)
        rows.append(
            {
                "N": players,
                "T": horizon,
                "stage recursion": yardstick.formatted(stages),
                "controls only": yardstick.formatted(controls),
                "one sparse LU": yardstick.formatted(one),
                "controls / stages": f"{controls / stages:.1f}",
                "sparse / stages": f"{one / stages:.1f}",
            }
        )
    note = (
        "Factorisation and one right-hand side, first system of a crosswalk, soft proximity; all "
        "three agree to 1e-6. Within one compiled program (sparse: SciPy's SuperLU on the finished "
        f"matrix). {yardstick.note}"
    )
    return [Result("Newton's linear system, three designs", note, rows).show(arguments.console)]
