"""Games between agents that differ in foresight: environments, equilibria and inference.

The names below are loaded on first use, so that importing this package does not load JAX.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foresight_env.compilation import enable_compilation_cache
    from foresight_env.equilibrium import (
        Budget,
        SolverOptions,
        Status,
        shift,
        solve,
        solve_many,
        verify,
    )
    from foresight_env.games import Game, Player
    from foresight_env.inverse import Free, MovingHorizonEstimator, estimate

    __version__: str

_ROOMS = {
    "Budget": "equilibrium",
    "Free": "inverse",
    "Game": "games",
    "MovingHorizonEstimator": "inverse",
    "Player": "games",
    "SolverOptions": "equilibrium",
    "Status": "equilibrium",
    "enable_compilation_cache": "compilation",
    "estimate": "inverse",
    "shift": "equilibrium",
    "solve": "equilibrium",
    "solve_many": "equilibrium",
    "verify": "equilibrium",
}

__all__ = [
    "Budget",
    "Free",
    "Game",
    "MovingHorizonEstimator",
    "Player",
    "SolverOptions",
    "Status",
    "__version__",
    "enable_compilation_cache",
    "estimate",
    "shift",
    "solve",
    "solve_many",
    "verify",
]


if not TYPE_CHECKING:  # type checkers would take any name for one of this module

    def __getattr__(name: str) -> Any:
        if name in _ROOMS:
            found = getattr(import_module(f"{__name__}.{_ROOMS[name]}"), name)
        elif name == "__version__":
            found = _version()
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _version() -> str:
    """Version of the installed distribution; of sources that are not installed, `0+unknown`."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("foresight_env")
    except PackageNotFoundError:
        return "0+unknown"
