"""Requirements of an installation without extras; `make test-bare` runs this in one.

Not a module of the test suite, which needs the extra `dev`.
"""

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

# As tests/conftest.py: compiling takes a third of the time.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false"
)
ABSENT = ("pyarrow", "typer", "rich", "jinja2", "equinox", "optax", "safetensors", "distributed")
"""Modules of extras; pillow is left out because matplotlib brings it."""


def solve_and_estimate():
    """Solve and verify a game of two, infer its discount factors from noisy observations."""
    import numpy as np

    from foresight_env import Free, Game, Player, Status, estimate, solve, verify
    from foresight_env.games import Bounds, DoubleIntegrator, Effort, Goal, full_state

    walker = Player(
        DoubleIntegrator(dt=0.2),
        costs=(Goal(1.0), Effort(0.1)),
        control_bounds=Bounds.box(-10.0, 10.0, 2),
    )
    game = Game((walker, walker), horizon=8)
    theta = ({"goal": [0.0, 0.0]}, {"goal": [2.0, 0.0]})
    start, gamma = [[2.0, 2.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]], [0.9, 0.6]
    solution = solve(game, start, theta, gamma)
    assert solution.status == Status.SOLVED, solution.status
    assert verify(game, solution, theta, gamma).is_local_equilibrium
    observed = np.concatenate(solution.states, axis=1)
    observed = observed + 1e-3 * np.random.default_rng(0).standard_normal(observed.shape)
    found = estimate(
        game,
        observed,
        full_state(game.state_sizes),
        initial_state=start,
        theta=theta,
        gamma=0.8,
        free=Free(gamma=True),
        covariance=1e-6,
    )
    assert np.abs(np.asarray(found.gamma) - gamma).max() < 0.05, found.gamma


def step_environments():
    """One rendered step of every environment."""
    import gymnasium

    import foresight_env.envs
    from foresight_env.names import SCENARIOS

    assert "crosswalk_v0" in foresight_env.envs.__all__
    for scenario in SCENARIOS:
        env = gymnasium.make(f"foresight/{scenario.capitalize()}-v0", render_mode="rgb_array")
        env.reset(seed=0)
        env.step(env.action_space.sample())
        picture = env.render()
        assert picture.ndim == 3, picture.shape
        assert picture.std() > 0.0
        env.close()


def missing(extra, function, *arguments):
    """Check that a call raises an error that names the extra."""
    try:
        function(*arguments)
    except ImportError as error:
        message = str(error)
    else:
        message = "no error"
    assert f"pip install 'foresight_env[{extra}]'" in message, message


def name_missing_extras():
    """Errors name a missing extra, and `foresight` does so in one line."""
    from importlib import import_module

    from agents import make_ego, make_predictor
    from foresight_env.datasets import open_recording

    missing("learned", make_predictor, "social-lstm")
    missing("learned", make_ego, "transformer+plan")
    missing("learned", make_ego, "cloned")
    missing("learned", import_module, "agents.learned.gamma")
    missing("evaluation", import_module, "evaluation.reports.page")
    missing("evaluation", import_module, "evaluation.studies.closed_loop")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clip_traj_ped_filtered.csv"
        path.write_text("id,frame,label,x_est,y_est,vx_est,vy_est\n0,0,ped,0,0,0,0\n")
        missing("evaluation", open_recording, path)
    make_predictor("constant-velocity")
    foresight = Path(sys.executable).with_name("foresight")
    for command in ([foresight], [foresight, "demo"], [sys.executable, "-m", "evaluation"]):
        run = subprocess.run(command, capture_output=True, text=True)
        assert run.returncode == 2, run
        assert run.stdout == "", run
        assert len(run.stderr.splitlines()) == 1, run
        assert "pip install 'foresight_env[evaluation]'" in run.stderr, run


def main():
    """Run all checks; the first one that fails ends in a traceback."""
    present = [name for name in ABSENT if find_spec(name)]
    assert not present, f"this is no bare installation, it has {', '.join(present)}"
    import foresight_env

    assert "site-packages" in foresight_env.__file__, foresight_env.__file__
    assert "jax" not in sys.modules
    name_missing_extras()
    solve_and_estimate()
    step_environments()
    loaded = [name for name in ABSENT if name in sys.modules]
    assert not loaded, loaded
    print(f"bare installation of foresight_env {foresight_env.__version__}: all checks passed")


if __name__ == "__main__":
    main()
