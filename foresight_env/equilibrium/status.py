"""Solver status."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Outcome of one solve; only `SOLVED` may be acted on."""

    SOLVED = 0
    ITERATION_LIMIT = 1
    """No point met the tolerance; the game may have no equilibrium near the start."""
    INFEASIBLE = 2
    """Constraints could not be met and their multipliers grew without bound."""
    DIVERGED = 3
    """Numbers overflowed or became NaN."""
    INVALID_INPUT = 4
    """Non-finite input, or an initial state outside hard bounds (traced calls only)."""

    @property
    def remedy(self) -> str:
        """Recommended remedy."""
        return {
            Status.SOLVED: "nothing to mend",
            Status.ITERATION_LIMIT: (
                "pass an `initial_guess` (a similar game's solution), raise the steps of "
                "SolverOptions, or soften hard constraints with a `penalty`"
            ),
            Status.INFEASIBLE: (
                "check that the initial state allows the constraints to hold at the first stages; "
                "give constraints that may fail a `penalty`"
            ),
            Status.DIVERGED: "check costs and constraints for NaN or overflow at the start",
            Status.INVALID_INPUT: "pass finite arrays and an initial state inside the bounds",
        }[self]


class SolveError(RuntimeError):
    """Raised by `solve(..., throw=True)` when a game was not solved."""

    def __init__(self, status: Status, residual: float):
        self.status = status
        super().__init__(
            f"solve: {status.name} (scaled KKT residual {residual:.1e}); remedy: {status.remedy}"
        )
