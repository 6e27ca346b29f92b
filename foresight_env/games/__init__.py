"""Games: dynamics, stage costs, discounting, constraints, observation models."""

from foresight_env.games.conflict import Body, Conflict
from foresight_env.games.constraints import (
    Bounds,
    Equality,
    Inequality,
    MinimumDistance,
    SharedInequality,
    SharedMinimumDistance,
)
from foresight_env.games.costs import (
    Composite,
    Effort,
    Goal,
    PreferredVelocity,
    SigmoidProximity,
    SquaredDistanceHinge,
    TargetSpeed,
)
from foresight_env.games.discounting import (
    CustomDiscounting,
    Discounting,
    Exponential,
    ExponentialPerSecond,
    Hyperbolic,
)
from foresight_env.games.dynamics import (
    CurvatureVehicle,
    DoubleIntegrator,
    Dynamics,
    KinematicBicycle,
    SlipBicycle,
    SmoothVehicle,
    Vehicle,
)
from foresight_env.games.game import Game, Player, inside_bounds
from foresight_env.games.observations import ObservationModel, full_state, positions
from foresight_env.games.paths import FootprintProximity, LaneBounds, PathFollowing
from foresight_env.games.permutation import PermutationInvariant
from foresight_env.games.roads import (
    Circle,
    Lane,
    LaneCenter,
    OutsideCircles,
    RoadBoundary,
    RoadSide,
)
from foresight_env.games.stage import stage_cost
from foresight_env.games.steering import Comfort, DrivingLimits, Steering

__all__ = [
    "Body",
    "Bounds",
    "Circle",
    "Comfort",
    "Composite",
    "Conflict",
    "CurvatureVehicle",
    "CustomDiscounting",
    "Discounting",
    "DoubleIntegrator",
    "DrivingLimits",
    "Dynamics",
    "Effort",
    "Equality",
    "Exponential",
    "ExponentialPerSecond",
    "FootprintProximity",
    "Game",
    "Goal",
    "Hyperbolic",
    "Inequality",
    "KinematicBicycle",
    "Lane",
    "LaneBounds",
    "LaneCenter",
    "MinimumDistance",
    "ObservationModel",
    "OutsideCircles",
    "PathFollowing",
    "PermutationInvariant",
    "Player",
    "PreferredVelocity",
    "RoadBoundary",
    "RoadSide",
    "SharedInequality",
    "SharedMinimumDistance",
    "SigmoidProximity",
    "SlipBicycle",
    "SmoothVehicle",
    "SquaredDistanceHinge",
    "Steering",
    "TargetSpeed",
    "Vehicle",
    "full_state",
    "inside_bounds",
    "positions",
    "stage_cost",
]
