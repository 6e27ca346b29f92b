"""Forward problem: from a game to its generalised open-loop Nash equilibrium."""

from foresight_env.equilibrium.batch.solve_many import solve_many
from foresight_env.equilibrium.settings import Budget, SolverOptions
from foresight_env.equilibrium.solve import WEAK_COMPLEMENTARITY, Solution, shift, solve
from foresight_env.equilibrium.status import SolveError, Status
from foresight_env.equilibrium.verification.verify import Verification, verify

__all__ = [
    "WEAK_COMPLEMENTARITY",
    "Budget",
    "Solution",
    "SolveError",
    "SolverOptions",
    "Status",
    "Verification",
    "shift",
    "solve",
    "solve_many",
    "verify",
]
