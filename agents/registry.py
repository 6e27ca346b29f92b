"""Egos and predictors by name, for the command line and the studies."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from inspect import Parameter, isfunction, signature
from typing import Any

from agents.egos.foresight import Foresight, farsighted
from agents.egos.oracle import Oracle
from agents.egos.predict_then_plan import PredictThenPlan, constant_velocity
from agents.interfaces.policy import EgoPolicy
from agents.interfaces.predictor import FunctionPredictor, Predictor
from agents.predictors.encounter import EncounterPredictor
from agents.predictors.idm import IdmPredictor
from agents.predictors.kalman import KalmanPredictor
from agents.predictors.kinematic import (
    ConstantTurnRateAccelerationPredictor,
    ConstantTurnRatePredictor,
    ConstantVelocityPredictor,
)
from agents.predictors.kkt_residual import KktResidualPredictor
from agents.predictors.orca import OrcaPredictor
from agents.predictors.particle_filter import ParticleFilterPredictor
from agents.predictors.social_force import SocialForcePredictor

EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    "oracle": Oracle,
    "foresight": Foresight,
    "farsighted": farsighted,
    "constant-velocity": constant_velocity,
}


def _idm() -> EgoPolicy[Any]:
    from agents.egos.idm import Idm  # loads highway-env, which the other egos do without

    return Idm()


DRIVING_EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {**EGOS, "idm": _idm}
"""Egos of cars; those beyond `EGOS` drive along paths only."""


def _reactive(name: str) -> EgoPolicy[Any]:
    from agents.learned.reactive import ReactiveEgo  # loads equinox

    return ReactiveEgo(name)


CROSSWALK_EGOS: dict[str, Callable[[], EgoPolicy[Any]]] = {
    **EGOS,
    **{name: partial(_reactive, name) for name in ("cloned", "ppo")},
}
"""Egos at the crosswalk; those beyond `EGOS` walk there only."""


PLANNED = "+plan"
"""What turns a predictor's name into that of an ego that plans with its forecasts."""


def make_ego(name: str) -> EgoPolicy[Any]:
    """The ego of that name, the planner with a predictor (`NAME+plan`), or `module:Class`.

    `ValueError` says what is wrong, and lists the names.
    """
    if name.endswith(PLANNED):
        stem = name.removesuffix(PLANNED)
        return PredictThenPlan(make_predictor(stem), name)
    if ":" in name:
        return _loaded("ego", name, EgoPolicy)
    known = {**DRIVING_EGOS, **CROSSWALK_EGOS}
    if name not in known:
        raise ValueError(
            f"ego: {name!r} is unknown; choose from {', '.join(known)}, a predictor's name "
            f"with {PLANNED}, or your own as module:Class"
        )
    return known[name]()


PREDICTORS: dict[str, Callable[[], Predictor]] = {
    "foresight": EncounterPredictor,
    "farsighted": lambda: EncounterPredictor(infer=False),
    "kkt-residual": KktResidualPredictor,
    "particle-filter": ParticleFilterPredictor,
    "constant-velocity": ConstantVelocityPredictor,
    "constant-turn-rate": ConstantTurnRatePredictor,
    "constant-acceleration": ConstantTurnRateAccelerationPredictor,
    "kalman": KalmanPredictor,
    "social-force": SocialForcePredictor,
    "orca": OrcaPredictor,
    "idm": IdmPredictor,
    "social-lstm": lambda: _learned("social-lstm"),
    "transformer": lambda: _learned("transformer"),
}


def _learned(name: str) -> Predictor:
    from agents.learned.predictor import LearnedPredictor  # loads equinox

    return LearnedPredictor(name)


def make_predictor(name: str) -> Predictor:
    """The predictor of that name, or `module:Class`; `ValueError` lists the names."""
    if ":" in name:
        return _loaded("predictor", name, Predictor)
    if name not in PREDICTORS:
        raise ValueError(
            f"predictor: {name!r} is unknown; choose from {', '.join(PREDICTORS)}, or your own as "
            "module:Class"
        )
    return PREDICTORS[name]()


def _required(function: Callable[..., Any]) -> list[str]:
    """Names of the arguments that must be given."""
    parameters = signature(function).parameters.values()
    return [p.name for p in parameters if p.default is p.empty and p.kind not in OPTIONAL]


OPTIONAL = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)


def _loaded(what: str, name: str, protocol: Any) -> Any:
    """What a user's module has under that name: an object, or what a class or function makes.

    A function of a history and a number of steps is a predictor itself.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except ImportError as error:
        raise ValueError(f"{what}: {name!r}: {module!r} cannot be imported ({error})") from error
    except AttributeError:
        raise ValueError(f"{what}: {name!r}: {module!r} has no {attribute!r}") from None
    if protocol is Predictor and isfunction(found) and len(_required(found)) == 2:
        return FunctionPredictor(found, name)
    ready = isinstance(found, protocol) and not isinstance(found, type)
    try:
        made = found() if callable(found) and not ready else found
    except TypeError as error:
        raise ValueError(
            f"{what}: {name!r} cannot be made without arguments ({error}); name an object, or a "
            "function that makes one"
        ) from error
    if not isinstance(made, protocol):
        wanted = "name, init, update and act" if protocol is EgoPolicy else "name and predict"
        raise ValueError(
            f"{what}: {name!r} is a {type(made).__name__}; expected something with {wanted}"
        )
    return made
