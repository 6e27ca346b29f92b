"""The command `foresight`: run, evaluate, estimate, demo."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import wraps
from pathlib import Path
from typing import Annotated, Any

import typer

# Typer brings a copy of Click or not, by its version; its own error derives from the right one.
UsageError: Any = typer.BadParameter.__mro__[1]

app = typer.Typer(
    help="Agents that differ in foresight: simulate them, infer it, judge who predicts best.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

EGO_NAMES = ("oracle", "foresight", "farsighted", "constant-velocity")
EGO_HELP = (
    "One of oracle, foresight (in tables: gamma inferred), farsighted (gamma = 1), "
    "constant-velocity; PREDICTOR+plan, the same planner with any predictor; or your own as "
    "module:Class."
)


DRIVING_EGO_NAMES = (*EGO_NAMES, "idm")


class Scenario(StrEnum):
    """Scenarios that can be run."""

    CROSSWALK = "crosswalk"
    INTERSECTION = "intersection"
    DRIVING = "driving"


class Scene(StrEnum):
    """Scenes of driving."""

    LEFT_TURN = "left_turn"
    MERGE = "merge"
    LANE_CHANGE = "lane_change"
    ROUNDABOUT = "roundabout"


class Observed(StrEnum):
    """What agents and estimators see."""

    FULL = "full"
    POSITIONS = "positions"


class Behaviour(StrEnum):
    """What the agents do that nobody controls."""

    RECEDING = "receding"
    OPEN_LOOP = "open_loop"
    IDM = "idm"


def keep_compiled_programs() -> None:
    """Let JAX keep compiled programs between runs, unless the user has said where or whether."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(cache / "foresight_env" / "jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.3")


def plain_errors(command: Callable[..., None]) -> Callable[..., None]:
    """Expected errors end in one line on standard error and exit status 2."""

    @wraps(command)
    def wrapped(*args: Any, **kwargs: Any) -> None:
        keep_compiled_programs()
        from foresight_env.equilibrium import (
            SolveError,  # loads JAX, which --help must not wait for
        )

        try:
            command(*args, **kwargs)
        except (ValueError, OSError, SolveError) as error:
            typer.echo(f"foresight: {' '.join(str(error).split())}", err=True)
            raise typer.Exit(2) from error
        except KeyboardInterrupt:
            typer.echo("foresight: interrupted; finished trials are kept", err=True)
            raise typer.Exit(130) from None

    return wrapped


def _one_s_own(name: str) -> bool:
    """Whether it names what the registry makes of a predictor's name or of a user's module."""
    return ":" in name or name.endswith("+plan")


def _check_ego(name: str) -> str:
    if name not in DRIVING_EGO_NAMES and not _one_s_own(name):
        raise typer.BadParameter(f"{name!r} is unknown; choose from {', '.join(DRIVING_EGO_NAMES)}")
    return name


def _listed(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """Names of a comma-separated option, each once."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ValueError(f"{option}: {unknown[0]!r} is unknown; choose from {', '.join(known)}")
    return names


def _agents(option: str, text: str, known: Sequence[str]) -> tuple[str, ...]:
    """The same, where names may also be what the registry can make."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    _listed(option, ",".join(name for name in names if not _one_s_own(name)) or known[0], known)
    _make_all(option, [name for name in names if _one_s_own(name)])
    return names


def _make_all(option: str, names: Sequence[str]) -> None:
    """Make agents once, so that what is wrong with them is told before anything runs."""
    if not names:
        return
    # As `python -m` does: a user's module is in the folder that the command runs in. Worker
    # processes take the path over.
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    from agents.registry import make_ego, make_predictor

    for name in names:
        (make_predictor if option == "--predictors" else make_ego)(name)


def _check_noise(std: float) -> None:
    if not math.isfinite(std):
        raise ValueError(f"--noise-std: is {std}; expected a finite number")


OutOption = Annotated[Path, typer.Option(help="Folder for results and pictures.")]
PlayersOption = Annotated[int, typer.Option(min=2, max=6, help="Number of agents.")]
NoiseOption = Annotated[
    float, typer.Option(min=0.0, help="Noise std of every observed coordinate, m and m/s.")
]
WorkersOption = Annotated[
    int | None,
    typer.Option(min=0, help="Processes; 0 runs in this one, default one per core."),
]


@app.command()
@plain_errors
def run(
    scenario: Annotated[Scenario, typer.Argument(help="Which scenario.")],
    ego: Annotated[
        str,
        typer.Option(
            callback=_check_ego,
            help=f"{EGO_HELP} In driving also idm, highway-env's own vehicle.",
        ),
    ] = "foresight",
    seed: Annotated[int, typer.Option(min=0, help="Episode.")] = 0,
    scene: Annotated[Scene, typer.Option(help="Of driving.")] = Scene.LEFT_TURN,
    players: Annotated[
        int | None, typer.Option(min=2, max=6, help="Number of agents or cars.")
    ] = None,
    observation: Annotated[Observed, typer.Option(help="What the ego sees.")] = Observed.FULL,
    behaviour: Annotated[
        Behaviour, typer.Option(help="What the others do; idm: cars of driving.")
    ] = Behaviour.RECEDING,
    noise_std: Annotated[
        float | None,
        typer.Option(min=0.0, help="Noise std of every observed coordinate; default: as usual."),
    ] = None,
    human: Annotated[bool, typer.Option("--human", help="Show it live in a window.")] = False,
    out: OutOption = Path("results/run"),
) -> None:
    """Run one episode: table, picture, animation, inferred discount factors over time."""
    if noise_std is not None:
        _check_noise(noise_std)
    if _one_s_own(ego):
        _make_all("--ego", [ego])
    elif ego not in EGO_NAMES and scenario is not Scenario.DRIVING:
        raise ValueError(f"--ego: {ego} drives cars of the scenario driving only")
    from evaluation.demonstration import run_one
    from evaluation.run_setting import RunSetting

    setting = RunSetting(
        scenario.value, scene.value, players, observation.value, noise_std, behaviour.value
    )
    run_one(ego, seed, setting, human, out)


evaluate = typer.Typer(no_args_is_help=True, help="Compare methods over many trials; figures.")
app.add_typer(evaluate, name="evaluate")


@evaluate.command("crosswalk")
@plain_errors
def evaluate_crosswalk(
    episodes: Annotated[
        int, typer.Option(min=0, help="Seeds of the closed-loop study; 0 leaves it out.")
    ] = 20,
    levels: Annotated[
        int, typer.Option(min=0, help="Noise levels of the estimation study; 0 leaves it out.")
    ] = 6,
    sequences: Annotated[int, typer.Option(min=1, help="Noisy sequences per level.")] = 10,
    grid: Annotated[
        int, typer.Option(min=0, help="Heatmap points per axis; 0 leaves it out.")
    ] = 41,
    egos: Annotated[
        str, typer.Option(help=f"Egos of the closed-loop study, comma-separated. {EGO_HELP}")
    ] = ",".join(EGO_NAMES),
    players: PlayersOption = 2,
    observation: Annotated[
        Observed, typer.Option(help="What the egos see in the closed loop.")
    ] = Observed.FULL,
    noise_std: NoiseOption = 0.05,
    workers: WorkersOption = None,
    out: OutOption = Path("results/evaluate"),
) -> None:
    """Compare egos in the closed loop, and estimation errors over noise; tables and figures.

    Interrupted studies go on where they stopped. The paper's size is --levels 50 --sequences 50.
    """
    names = _agents("--egos", egos, EGO_NAMES)
    _check_noise(noise_std)
    if grid == 1:
        raise ValueError("--grid: is 1; a heatmap has at least 2 points per axis")
    from evaluation import demonstration

    demonstration.evaluate_crosswalk(
        episodes,
        levels,
        sequences,
        grid,
        names,
        players,
        observation.value,
        noise_std,
        workers,
        out,
    )


@evaluate.command("driving")
@plain_errors
def evaluate_driving(
    episodes: Annotated[int, typer.Option(min=1, help="Noise seeds; the paper has 50.")] = 10,
    scenes: Annotated[
        str, typer.Option(help=f"Comma-separated, of {', '.join(Scene)}.")
    ] = Scene.LEFT_TURN.value,
    others: Annotated[
        str,
        typer.Option(help="What the other cars do, comma-separated: receding (the game), idm."),
    ] = f"{Behaviour.RECEDING.value},{Behaviour.IDM.value}",
    egos: Annotated[
        str, typer.Option(help=f"Comma-separated, of {', '.join(DRIVING_EGO_NAMES)}.")
    ] = ",".join(DRIVING_EGO_NAMES),
    cars: Annotated[int, typer.Option(min=2, max=6, help="Number of cars.")] = 4,
    observation: Annotated[Observed, typer.Option(help="What the egos see.")] = Observed.FULL,
    noise_std: NoiseOption = 0.1,
    workers: WorkersOption = None,
    out: OutOption = Path("results/driving"),
) -> None:
    """Egos that turn, merge, change lanes and go round among other cars; tables and figures.

    Interrupted studies go on where they stopped; more --episodes, --scenes or --egos are added to
    what is there. A decision of an ego that infers takes a fifth of a second or so: ten seeds of
    one scene take some ten minutes on two cores.
    """
    _check_noise(noise_std)
    chosen = (
        _listed("--scenes", scenes, tuple(Scene)),
        _listed("--others", others, tuple(Behaviour)),
        _agents("--egos", egos, DRIVING_EGO_NAMES),
    )
    from evaluation import demonstration
    from evaluation.driving_study import DrivingSetting

    setting = DrivingSetting(cars, noise_std, observation.value)
    demonstration.evaluate_driving(episodes, *chosen, setting, workers, out)


class Place(StrEnum):
    """What is known of the place of a recording."""

    AUTO = "auto"
    AACHEN = "aachen"
    OPEN = "open"


class Parameters(StrEnum):
    """What is estimated beside discount factors."""

    GOALS = "goals"
    ALL = "all"


def _frames(text: str) -> tuple[int, int]:
    parts = text.split(":")
    if len(parts) != 2 or not all(part.strip().isdecimal() for part in parts):
        raise ValueError(f"--frames: is {text!r}; expected FIRST:LAST, such as 26158:26320")
    return int(parts[0]), int(parts[1])


@evaluate.command("intersection")
@plain_errors
def evaluate_intersection(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder or file of recordings (inD, DUT, UCY); without it, a recording that the "
            "project makes itself."
        ),
    ] = None,
    recording: Annotated[
        str | None, typer.Option(help="Which recording of a folder, such as 07 or intersection_15.")
    ] = None,
    tracks: Annotated[
        str | None, typer.Option(help="Agents, such as 201,205,207,208 or veh:0,ped:6.")
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option(help="FIRST:LAST, both included; default: while all of them are there."),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Take every n-th frame.")] = 6,
    place: Annotated[
        Place,
        typer.Option(
            help="aachen: the published corners, sides and lanes; open: none; auto: the first for "
            "inD tracks that lie there."
        ),
    ] = Place.AUTO,
    parameters: Annotated[
        Parameters,
        typer.Option(help="Estimated beside gamma: goals, or weights and distances as well."),
    ] = Parameters.GOALS,
    levels: Annotated[int, typer.Option(min=1, help="Noise levels, std 0 to 0.1.")] = 6,
    sequences: Annotated[int, typer.Option(min=1, help="Noisy sequences per level.")] = 10,
    at: Annotated[int, typer.Option(help="Steps that the prediction's picture has seen.")] = 15,
    workers: WorkersOption = None,
    out: OutOption = Path("results/intersection"),
) -> None:
    """Recorded people and cars: estimation error over noise, and a prediction (paper, VI-B)."""
    if data is None and (recording or tracks or frames):
        raise ValueError("--recording, --tracks, --frames: need --data")
    if data is not None and tracks is None:
        raise ValueError("--tracks: is missing; name the agents, such as 201,205,207,208")
    from evaluation import demonstration
    from evaluation.intersection_window import Choice

    choice = None
    if data is not None:
        names = tuple(name.strip() for name in (tracks or "").split(","))
        span = None if frames is None else _frames(frames)
        choice = Choice(str(data), names, span, every, recording, place.value)
    demonstration.evaluate_intersection(
        choice, levels, sequences, parameters.value, at, workers, out
    )


PREDICTOR_NAMES = (
    "foresight",
    "farsighted",
    "kkt-residual",
    "particle-filter",
    "constant-velocity",
    "constant-turn-rate",
    "constant-acceleration",
    "kalman",
    "social-force",
    "orca",
    "idm",
)


class Split(StrEnum):
    """Which recordings of a folder."""

    ALL = "all"
    DEVELOPMENT = "development"
    TEST = "test"


@evaluate.command("prediction")
@plain_errors
def evaluate_prediction(
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder of recordings (inD, DUT, UCY), searched with all below it, or a file; "
            "without it, a recording that the project makes itself."
        ),
    ] = None,
    predictors: Annotated[
        str,
        typer.Option(
            help=f"Comma-separated, of {', '.join(PREDICTOR_NAMES)}; your own as module:Class."
        ),
    ] = ",".join(PREDICTOR_NAMES),
    split: Annotated[
        Split,
        typer.Option(
            help="development: the recordings that settings were chosen on; test: all others."
        ),
    ] = Split.ALL,
    workers: WorkersOption = None,
    out: OutOption = Path("results/prediction"),
) -> None:
    """Predict recorded agents who interact: errors over 1 to 4 s, misses, overlaps, latency."""
    names = _agents("--predictors", predictors, PREDICTOR_NAMES)
    from evaluation import demonstration

    demonstration.evaluate_prediction(data, names, split.value, workers, out)


@app.command()
@plain_errors
def estimate(
    file: Annotated[
        Path, typer.Argument(help="A DUT (*_ped_filtered.csv), UCY (obsmat.txt) or inD recording.")
    ],
    ids: Annotated[
        str | None, typer.Option(help="Two agents, such as 'veh:0,ped:6' (DUT) or '16,18' (UCY).")
    ] = None,
    count: Annotated[
        int, typer.Option(min=0, help="Without --ids: how many closest crossings; 0 for all.")
    ] = 3,
    recording: Annotated[
        str | None, typer.Option(help="Number of the recording in an inD folder, such as 07.")
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw each encounter.")] = True,
    out: OutOption = Path("results/estimate"),
) -> None:
    """Recorded data: infer on the first part of an encounter, predict the rest, compare."""
    from evaluation.demonstration import estimate_recorded

    agents = None if ids is None else tuple(part.strip() for part in ids.split(","))
    estimate_recorded(file, agents, count or None, recording, pictures, out)


@app.command()
@plain_errors
def demo(
    data: Annotated[
        Path | None,
        typer.Option(help="A recording to end on; default: one that the project makes itself."),
    ] = None,
    workers: WorkersOption = None,
    out: OutOption = Path("results/demo"),
) -> None:
    """The whole idea in about two minutes: agents, inference, comparison, recorded data."""
    from evaluation.demonstration import demonstrate

    demonstrate(data, workers, out)


def main() -> None:
    """Run the command; whatever is wrong with its arguments is one line, and exit status 2."""
    try:
        status = app(standalone_mode=False, prog_name="foresight")
    except UsageError as error:
        told = " ".join(error.format_message().split())
        if told:  # nothing when the command stands alone: then its help has been shown
            typer.echo(f"foresight: {told}", err=True)
        sys.exit(2)
    sys.exit(status if isinstance(status, int) else 0)


if __name__ == "__main__":
    main()
