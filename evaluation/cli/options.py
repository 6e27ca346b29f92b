"""Options, checks and error messages that the commands share."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from agents.registry import (
    ALL_EGOS,
    ALL_PREDICTORS,
    CROSSWALK_EGOS,
    DRIVING_EGOS,
    EGOS,
    PREDICTORS,
    check_extra,
    is_custom,
    make_ego,
    make_predictor,
)
from foresight_env.extras import MissingExtraError

EGO_NAMES = tuple(EGOS)
DRIVING_EGO_NAMES = tuple(DRIVING_EGOS)
CROSSWALK_EGO_NAMES = tuple(CROSSWALK_EGOS)
ALL_EGO_NAMES = tuple(ALL_EGOS)
PREDICTOR_NAMES = tuple(PREDICTORS)
ALL_PREDICTOR_NAMES = tuple(ALL_PREDICTORS)
"""With those that need the game of a simulated place."""
EGO_HELP = (
    f"One of {', '.join(EGO_NAMES)}; PREDICTOR+plan, the same planner with any predictor; or your "
    "own as module:Class."
)
Split = Literal["all", "development", "test"]
"""Which recordings of a folder."""


def chosen_seeds(seeds: Seeds, episodes: int) -> range:
    """Return the first seeds of a kind; `ValueError` where there are fewer than `episodes`."""
    from evaluation.rollout.places import DEVELOPMENT_SEEDS, TEST_SEEDS

    available = DEVELOPMENT_SEEDS if seeds == "development" else TEST_SEEDS
    if episodes > len(available):
        raise ValueError(f"--episodes: is {episodes}; there are {len(available)} {seeds} seeds")
    return available[:episodes]


def _tell(line: str) -> None:
    typer.echo(f"foresight: {line}", err=True)


def plain_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Expected errors end in one line on standard error and exit status 2."""

    @wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        # Here, since they load JAX, which --help must not wait for.
        from foresight_env import compilation
        from foresight_env.equilibrium import SolveError

        compilation.enable_compilation_cache()

        try:
            with compilation.announce_compilation(_tell):
                command(*args, **kwargs)
        except (ValueError, OSError, SolveError, MissingExtraError) as error:
            typer.echo(f"foresight: {' '.join(str(error).split())}", err=True)
            raise typer.Exit(2) from error
        except KeyboardInterrupt:
            typer.echo("foresight: interrupted; finished trials are kept", err=True)
            raise typer.Exit(130) from None

    return wrapped


def check_ego(name: str) -> str:
    """Check the option `--ego`: a registered name, or a custom one."""
    if name not in ALL_EGO_NAMES and not is_custom(name):
        raise typer.BadParameter(f"{name!r} is unknown; choose from {', '.join(ALL_EGO_NAMES)}")
    return name


def listed(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """Names of a comma-separated option, each once."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"{option}: {unknown[0]!r} is unknown; choose from {', '.join(known)}")
    return names


def chosen_agents(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """The same, where names may also be what the registry can make.

    Raises:
        ValueError: a name is unknown, or two agents would have the same name in tables.
    """
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    plain = [name for name in names if not is_custom(name)]
    listed(option, ",".join(plain) or known[0], known)
    for name in names:
        check_extra(name)
    shown = dict(zip(plain, plain, strict=True))
    custom = [name for name in names if is_custom(name)]
    for name, agent in zip(custom, make_all(option, custom), strict=True):
        other = shown.setdefault(str(agent.name), name)
        if other != name:
            raise ValueError(
                f"{option}: {other} and {name} are both named {agent.name!r}; give each agent its "
                "own name"
            )
    return names


def look_here() -> None:
    """As `python -m` does: a user's module is in the folder that the command runs in.

    Worker processes take the path over.
    """
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())


def make_all(option: str, names: Sequence[str]) -> list[Any]:
    """Make and return agents, so that errors in them are raised before anything runs."""
    if not names:
        return []
    look_here()
    return [(make_predictor if option == "--predictors" else make_ego)(name) for name in names]


def check_noise(std: float) -> None:
    """For the option `--noise-std`, whose lower limit lets NaN through."""
    if not math.isfinite(std):
        raise ValueError(f"--noise-std: is {std}; expected a finite number")


def table_columns(text: str | None) -> dict[str, str] | None:
    """Meaning of `--columns`: the library's name -> the file's (`Recording.from_dataframe`).

    Raises:
        ValueError: there are unnamed entries other than four, or a name is repeated.
    """
    if text is None:
        return None
    entries = [entry.strip() for entry in text.split(",")]
    unnamed = [entry for entry in entries if "=" not in entry]
    if len(unnamed) not in (0, len(TABLE_ORDER)) or "" in unnamed:
        raise ValueError(
            f"--columns: is {text!r}; expected the file's names of {', '.join(TABLE_ORDER)}, such "
            "as t,person,x,y, or named ones, such as frame=n,agent=person,kind=class"
        )
    found = dict(zip(TABLE_ORDER, unnamed, strict=False))
    for entry in entries:
        name, named, user = (part.strip() for part in entry.partition("="))
        if named and name in found:
            raise ValueError(f"--columns: names {name} twice; name each column once")
        if named:
            found[name] = user
    return found


TABLE_ORDER = ("time", "agent", "x", "y")
"""Columns that `--columns` lists without their names, in this order."""
ColumnsOption = Annotated[
    str | None,
    typer.Option(
        help="Of a CSV file: its columns for time (s), agent, x, y (m), such as t,person,x,y; "
        "others by name, such as frame=n,agent=person,x=px,y=py,kind=class,heading=psi.",
    ),
]
RateOption = Annotated[
    float | None,
    typer.Option(
        help="Hz: rows of a CSV file per second and agent; frame numbers per second of UCY "
        "(default 25; ETH's first scene has 15).",
        show_default=False,
    ),
]
OutOption = Annotated[Path, typer.Option(help="Folder for results and pictures.")]
PlayersOption = Annotated[int, typer.Option(min=2, max=6, help="Number of agents.")]
NoiseOption = Annotated[
    float, typer.Option(min=0.0, help="Noise std of every observed coordinate, m and m/s.")
]
SafetyFilterOption = Annotated[
    bool,
    typer.Option(
        help="Replace actions after which an ego could no longer evade; the same for all egos."
    ),
]
Seeds = Literal["development", "test"]
"""Episodes: those that settings were chosen on, or the others."""
SeedsOption = Annotated[
    Seeds, typer.Option(help="development: those that settings were chosen on.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option(min=0, help="Processes; 0 runs in this one, default one per core."),
]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Run on a Dask cluster: its scheduler, as tcp://host:8786."
    ),
]


def chosen_workers(workers: int | None, cluster: str | None) -> int | str | None:
    """Meaning of `--workers` and `--cluster` together (`evaluation.execution.local.Workers`)."""
    if cluster is None:
        return workers
    if workers is not None:
        raise ValueError("--workers: counts processes of this machine; leave it out with --cluster")
    return cluster
