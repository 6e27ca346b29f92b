"""Egos and predictors by name. A name is that of the object that it makes.

Modules are loaded when an agent is made, so that names can be listed without JAX.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from inspect import Parameter, isfunction, signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foresight_env.extras import require

if TYPE_CHECKING:
    from agents.interfaces.policy import EgoPolicy
    from agents.interfaces.predictor import Predictor


def _make(module: str, attribute: str, *args: Any, **kwargs: Any) -> Any:
    return getattr(import_module(f"agents.{module}"), attribute)(*args, **kwargs)


def _entry(module: str, attribute: str, *args: Any, **kwargs: Any) -> Callable[[], Any]:
    return partial(_make, module, attribute, *args, **kwargs)


EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    "oracle": _entry("egos.oracle", "Oracle"),
    "infer-gamma": _entry("egos.infer_gamma", "InferGamma"),
    "assume-gamma-1": _entry("egos.infer_gamma", "assume_gamma_1"),
    "constant-velocity": _entry("egos.predict_then_plan", "constant_velocity"),
}
"""Egos of every scenario."""
REFERENCE_EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    "know-gamma": _entry("egos.infer_gamma", "know_gamma"),
}
"""Egos that see a part of the truth, to measure its value; the oracle sees all."""
ROAD_EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {"idm": _entry("egos.idm", "Idm")}
"""Egos that drive along paths only."""
REACTIVE_EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    name: _entry("learned.reactive", "ReactiveEgo", name) for name in ("cloned", "ppo")
}
"""Networks that act without planning, at the crosswalk only."""
DRIVING_EGOS = {**EGOS, **ROAD_EGOS}
CROSSWALK_EGOS = {**EGOS, **REACTIVE_EGOS}
ALL_EGOS = {**EGOS, **REFERENCE_EGOS, **ROAD_EGOS, **REACTIVE_EGOS}

FORECASTERS = ("social-lstm", "transformer")
"""Networks that predict."""
HYBRID = "hybrid-game"
"""The network whose proposals a game makes equilibria."""
HYBRIDS = {HYBRID: "infer-gamma", f"{HYBRID}-gamma-1": "assume-gamma-1", "hybrid-network": "none"}
"""Game between that network's proposals, by predictors' names; all use its weights."""
PREDICTORS: dict[str, Callable[..., Predictor]] = {
    **{
        name: _entry("hybrid.predictor", "HybridPredictor", game=game)
        for name, game in HYBRIDS.items()
    },
    "encounter-game": _entry("predictors.encounter", "EncounterPredictor"),
    "encounter-game-gamma-1": _entry("predictors.encounter", "EncounterPredictor", infer=False),
    "junction-game": _entry("predictors.junction", "JunctionPredictor"),
    "junction-game-gamma-1": _entry("predictors.junction", "JunctionPredictor", infer=False),
    "kkt-residual": _entry("predictors.kkt_residual", "KktResidualPredictor"),
    "particle-filter": _entry("predictors.particle_filter", "ParticleFilterPredictor"),
    "constant-velocity": _entry("predictors.kinematic", "ConstantVelocityPredictor"),
    "constant-velocity-sampled": _entry("predictors.sampled_velocity", "SampledVelocityPredictor"),
    "constant-turn-rate": _entry("predictors.kinematic", "ConstantTurnRatePredictor"),
    "constant-acceleration": _entry(
        "predictors.kinematic", "ConstantTurnRateAccelerationPredictor"
    ),
    "kalman": _entry("predictors.kalman", "KalmanPredictor"),
    "social-force": _entry("predictors.social_force", "SocialForcePredictor"),
    "orca": _entry("predictors.orca", "OrcaPredictor"),
    "idm": _entry("predictors.idm", "IdmPredictor"),
    **{name: _entry("learned.predictor", "LearnedPredictor", name) for name in FORECASTERS},
}
SCENE_PREDICTORS: dict[str, Callable[..., Predictor]] = {
    "scene-game": _entry("predictors.scene_game", "SceneGamePredictor"),
    "scene-game-gamma-1": _entry("predictors.scene_game", "SceneGamePredictor", infer=False),
}
"""Predictors that need the game of the place (`History.context.game`): in simulation only."""
ALL_PREDICTORS = {**PREDICTORS, **SCENE_PREDICTORS}

LEARNED = (*FORECASTERS, *HYBRIDS, *REACTIVE_EGOS)
"""Networks, which need the extra `learned`."""

PLANNED = "+plan"
"""Suffix that makes a predictor's name that of an ego that plans with its forecasts."""


def is_custom(name: str) -> bool:
    """Whether a name is made by the registry's rules: `NAME+plan` or `module:attribute`."""
    return ":" in name or name.endswith(PLANNED)


def check_extra(name: str) -> None:
    """Check that the optional dependencies of a registered agent, or of `NAME+plan`, are installed.

    Raises:
        MissingExtraError: the agent is a network and the extra `learned` is not installed.
    """
    if name.removesuffix(PLANNED) in LEARNED:
        require("learned", name)


def make_ego(name: str) -> EgoPolicy[Any]:
    """Make an ego: a registered name, `PREDICTOR+plan`, or your own as `module:Class`.

    Raises:
        ValueError: the name is unknown or its module cannot be used; the message lists the names.
        MissingExtraError: it is a network and the extra `learned` is not installed.
    """
    check_extra(name)
    if name.endswith(PLANNED):
        from agents.egos.predict_then_plan import PredictThenPlan

        predictor = make_predictor(name.removesuffix(PLANNED))
        return PredictThenPlan(predictor, predictor.name + PLANNED)
    if ":" in name:
        from agents.interfaces.policy import EgoPolicy

        return _loaded("ego", name, EgoPolicy, "name, init, update and act")
    if name not in ALL_EGOS:
        raise ValueError(
            f"ego: {name!r} is unknown; choose from {', '.join(ALL_EGOS)}, a predictor's name "
            f"with {PLANNED}, or your own as module:Class"
        )
    return ALL_EGOS[name]()


def make_predictor(name: str, weights: str | Path | None = None) -> Predictor:
    """Make a predictor: a registered name, or your own as `module:Class` or `module:function`.

    Args:
        name: The name.
        weights: Folder of weights, in place of the shipped ones: a network of the library reads
            `NAME.safetensors` there (`weights_file`); your own class or function gets the folder
            where it has a parameter `weights`. All others ignore it.

    Raises:
        ValueError: the name is unknown, its module cannot be used, or the folder lacks a network's
            weights; the message lists the names or names the file.
        MissingExtraError: it is a network and the extra `learned` is not installed.
    """
    check_extra(name)
    if ":" in name:
        from agents.interfaces.predictor import Predictor

        return _loaded("predictor", name, Predictor, "name and predict", weights)
    if name not in ALL_PREDICTORS:
        raise ValueError(
            f"predictor: {name!r} is unknown; choose from {', '.join(ALL_PREDICTORS)}, or your own "
            "as module:Class"
        )
    if weights is None or name not in LEARNED:
        return ALL_PREDICTORS[name]()
    path = weights_file(weights, name)
    if not path.is_file():
        raise ValueError(f"{path}: is missing; train {name}, or name another folder of weights")
    return ALL_PREDICTORS[name](weights=str(path))


def weights_file(folder: str | Path, name: str) -> Path:
    """Path of the weights of a network of the library in a folder of weights."""
    return Path(folder) / f"{HYBRID if name in HYBRIDS else name}.safetensors"


def _required(function: Callable[..., Any]) -> list[str]:
    """Names of the arguments that must be given."""
    parameters = signature(function).parameters.values()
    optional = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)
    return [p.name for p in parameters if p.default is p.empty and p.kind not in optional]


def _loaded(
    what: str, name: str, protocol: Any, members: str, weights: str | Path | None = None
) -> Any:
    """An object of a user's module, or what a class or function there makes.

    A function of a history and a number of steps is a predictor itself. `weights`: folder that is
    passed on where the class or function has a parameter of that name.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except ImportError as error:
        raise ValueError(f"{what}: {name!r}: {module!r} cannot be imported ({error})") from error
    except AttributeError:
        raise ValueError(f"{what}: {name!r}: {module!r} has no {attribute!r}") from None
    if what == "predictor" and isfunction(found) and len(_required(found)) == 2:
        from agents.interfaces.predictor import FunctionPredictor

        return FunctionPredictor(found, attribute)
    ready = isinstance(found, protocol) and not isinstance(found, type)
    given = {}
    if weights is not None and not ready and "weights" in signature(found).parameters:
        given["weights"] = str(weights)
    try:
        made = found(**given) if callable(found) and not ready else found
    except TypeError as error:
        raise ValueError(
            f"{what}: {name!r} cannot be made without arguments ({error}); name an object, or a "
            "function that makes one"
        ) from error
    if not isinstance(made, protocol):
        raise ValueError(
            f"{what}: {name!r} is a {type(made).__name__}; expected something with {members}"
        )
    return made
