"""Players that are alike are evaluated side by side: the numbers must be those of one by one."""

from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from foresight_env.equilibrium.conditions.identical_players import identical_players, moving_alike
from foresight_env.equilibrium.conditions.kkt import Iterate, Parameters
from foresight_env.equilibrium.conditions.layout import layout_of
from foresight_env.equilibrium.conditions.linearisation import first_order
from foresight_env.equilibrium.conditions.pairs import pairs_of
from foresight_env.equilibrium.conditions.residual import evaluate
from foresight_env.games import (
    Circle,
    Composite,
    Effort,
    Game,
    Goal,
    KinematicBicycle,
    Lane,
    LaneCenter,
    Player,
    RoadSide,
)
from foresight_env.games.kinds import is_vehicle
from foresight_env.games.permutation import distinguishes
from foresight_env.scenarios import crosswalk, driving, encounter, intersection
from foresight_env.scenarios.intersection import Region

HORIZON = 4


def straight(offset):
    places = np.linspace(-20.0, 40.0, 31)
    zero = np.zeros_like(places)
    return np.stack([places, zero + offset, zero, zero], axis=1)


def crossing(players, proximity):
    theta = [crosswalk.player_theta(np.array([k, 1.0])) for k in range(players)]
    return crosswalk.crosswalk_game(players, HORIZON, proximity), theta


REGION = Region((Circle((5.0, 5.0), 1.0),), (RoadSide((0.0, -9.0), (30.0, -9.0), "left"),))


def junction(*kinds, lanes=None):
    lanes = (None,) * len(kinds) if lanes is None else lanes
    game = intersection.intersection_game(kinds, lanes, REGION, HORIZON)
    theta = [intersection.player_theta(kind, np.array([k, 3.0])) for k, kind in enumerate(kinds)]
    return game, theta


def meeting(*kinds):
    theta = [
        encounter.player_theta(kind, (5.0, 0.01) if is_vehicle(kind) else np.array([1.0, k]))
        for k, kind in enumerate(kinds)
    ]
    return encounter.encounter_game(kinds, HORIZON, 0.1), theta


def drive():
    theta = [
        driving.player_theta(straight(0.1 * k), 5.0 + k, np.array([30.0, 0.0])) for k in range(3)
    ]
    return driving.driving_game(3, HORIZON), theta


GAMES = {
    "soft": lambda: crossing(3, "soft"),
    "shared": lambda: crossing(3, "hard"),
    "undiscounted": lambda: crossing(2, "reference"),
    "cars": drive,
    "mixed": lambda: junction("car", "pedestrian", "pedestrian", "car", "car"),
    "in turn": lambda: junction("pedestrian", "car", "pedestrian"),
    "lanes": lambda: junction(
        "car", "car", "car", lanes=(Lane((0.1, 0.0, 1.0)), None, Lane((0.2, 1.0)))
    ),
    "own lanes": lambda: junction(
        "pedestrian", "car", "car", lanes=(None, Lane((0.1, 0.0, 1.0)), Lane((0.2, 1.0), angle=0.3))
    ),
    "meeting": lambda: meeting("pedestrian", "pedestrian", "car", "car", "bicycle"),
}


@dataclass(frozen=True)
class Nameless:
    """The same function, which does not declare whom it distinguishes."""

    function: Any

    def __call__(self, *arguments):
        return self.function(*arguments)


@dataclass(frozen=True)
class NamelessComposite(Nameless):
    def residual(self, *arguments):
        return self.function.residual(*arguments)

    def loss(self, *arguments):
        return self.function.loss(*arguments)


def one_by_one(game: Game) -> Game:
    """The same game, with no players that are known to be alike."""

    def nameless(costs):
        return tuple(
            (NamelessComposite if isinstance(cost, Composite) else Nameless)(cost) for cost in costs
        )

    players = [
        replace(
            player,
            costs=nameless(player.costs),
            undiscounted_costs=nameless(player.undiscounted_costs),
            inequalities=tuple(
                replace(c, function=Nameless(c.function)) for c in player.inequalities
            ),
            # Equal dynamics are distinguished, too.
            dynamics=Numbered(player.dynamics, number),
        )
        for number, player in enumerate(game.players)
    ]
    return replace(game, players=tuple(players))


@dataclass(frozen=True)
class Numbered:
    dynamics: Any
    number: int

    def __getattr__(self, name):
        return getattr(self.dynamics, name)

    @property
    def state_size(self):
        return self.dynamics.state_size

    @property
    def control_size(self):
        return self.dynamics.control_size

    @property
    def linear(self):
        return self.dynamics.linear

    def __call__(self, *arguments):
        return self.dynamics(*arguments)


def members(game, theta):
    return sorted(
        {tuple(these.members) for these in identical_players(layout_of(game), tuple(theta))}
    )


def test_who_is_alike():
    assert members(*GAMES["soft"]()) == [(0, 1, 2)]
    assert members(*GAMES["cars"]()) == [(0, 1, 2)]
    assert members(*GAMES["mixed"]()) == [(0,), (1, 2), (3, 4)]
    assert members(*GAMES["in turn"]()) == [(0,), (1,), (2,)]
    assert members(*GAMES["meeting"]()) == [(0, 1), (2, 3), (4,)]
    # Lanes are their owners' alone; everything else is common.
    assert members(*GAMES["lanes"]()) == [(0,), (0, 1, 2), (2,)]
    assert members(*GAMES["own lanes"]()) == [(0,), (1, 2)]
    game, theta = GAMES["mixed"]()
    assert [tuple(run) for run in moving_alike(game)] == [(0,), (1, 2), (3, 4)]
    assert members(one_by_one(game), theta) == [(0,), (1,), (2,), (3,), (4,)]
    # Arrays of other shapes cannot stand side by side.
    game, theta = GAMES["cars"]()
    theta[1] = {**theta[1], "path": straight(0.1)[:20]}
    assert members(game, theta) == [(0,), (1,), (2,)]


def at_random(game, theta):
    random, layout = np.random.default_rng(0), layout_of(game)
    pairs = layout.pair_count
    point = Iterate(
        jnp.asarray(1.0 + random.normal(size=(HORIZON, layout.n))),
        jnp.asarray(0.1 * random.normal(size=(HORIZON, layout.m))),
        jnp.asarray(random.uniform(0.1, 1.0, (HORIZON, pairs))),
        jnp.asarray(random.uniform(0.1, 1.0, (HORIZON, pairs))),
    )
    thetas = tuple({k: jnp.asarray(v, float) for k, v in t.items()} for t in theta)
    gamma = jnp.asarray(random.uniform(0.5, 1.0, len(game.players)))
    return point, Parameters(jnp.asarray(random.normal(size=layout.n)), thetas, gamma)


@pytest.mark.parametrize("name", GAMES)
def test_side_by_side_is_one_by_one(name):
    game, theta = GAMES[name]()

    def systems(game):
        layout, pairs = layout_of(game), pairs_of(layout_of(game))
        convexity = jnp.asarray(0.4)

        @jax.jit
        def derivatives(point, parameters):
            return evaluate(layout, pairs, point, parameters, convexity, 1e-3)

        return derivatives(*at_random(game, theta))

    with jax.enable_x64(True):
        found, wanted = systems(game), systems(one_by_one(game))
    assert any(len(these) > 1 for these in members(game, theta)) or name == "in turn"
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-10), found, wanted
    )


@pytest.mark.parametrize("name", GAMES)
def test_parts_that_are_alike_say_so_truly(name):
    """Given its own view of the others, one number's function is the other's."""
    game, theta = GAMES[name]()
    random = np.random.default_rng(1)
    x = [jnp.asarray(random.normal(size=n)) for n in game.state_sizes]
    u = [jnp.asarray(0.1 * random.normal(size=m)) for m in game.control_sizes]
    compared = 0
    for these in identical_players(layout_of(game), tuple(theta)):
        first = these.first
        for i in these.members[1:]:
            order = [j for j in range(len(x)) if j != i]
            order.insert(first, i)
            seen = tuple(x[j] for j in order), tuple(u[j] for j in order)
            costs = (*these.costs, *these.undiscounted_costs)
            bound = [
                cost if own is None else cost.with_constants(jax.tree.map(lambda v: v[-1], own))
                for cost, own in zip(costs, these.constants, strict=True)
            ]
            for part in (*bound, *these.constraints):
                own = part(i, 1, tuple(x), tuple(u), theta[i])
                np.testing.assert_allclose(part(first, 1, *seen, theta[i]), own)
                compared += 1
    assert compared or name == "in turn"


def test_strangers_are_told_apart():
    assert distinguishes(lambda i, t, x, u, theta: x[0][0], 0, 1)
    assert not distinguishes(Goal(), 0, 1)
    walker, car = "pedestrian", "car"
    game, _ = junction(walker, walker, car)
    near = game.players[0].costs[2]
    assert not distinguishes(near, 0, 1)
    assert distinguishes(near, 1, 2)
    assert not distinguishes(Effort(), 0, 5)


def test_promises_are_not_inherited_by_other_functions():
    @dataclass(frozen=True)
    class LastOneCares(Goal):
        def __call__(self, i, t, x, u, theta):
            return i * Goal.__call__(self, i, t, x, u, theta)

    @dataclass(frozen=True)
    class Renamed(Goal):
        pass

    @dataclass(frozen=True)
    class Promised(LastOneCares):
        def distinguishes(self, i, j):
            return False

    assert distinguishes(LastOneCares(), 0, 1)
    assert not distinguishes(Renamed(), 0, 1)
    assert not distinguishes(Promised(), 0, 1)


def test_a_cost_that_is_there_twice_counts_twice():
    game, theta = crossing(3, "soft")

    def paying(*costs):
        players = tuple(replace(player, costs=costs) for player in game.players)
        layout = layout_of(replace(game, players=players))
        point, parameters = at_random(game, theta)
        exact = jnp.asarray(0.0)
        return evaluate(layout, pairs_of(layout), point, parameters, exact, 1e-3).lin

    with jax.enable_x64(True):
        twice, double = paying(Goal(1.0), Goal(1.0)), paying(Goal(2.0))
    np.testing.assert_allclose(twice.gradient, double.gradient, atol=1e-12)
    np.testing.assert_allclose(twice.hessian, double.hessian, atol=1e-12)


@dataclass(frozen=True)
class Quartic(LaneCenter):
    """A user's cost that computes something else of the same lane."""

    def loss(self, value, theta):
        return jnp.sum(value**4)


def test_derived_costs_are_evaluated_themselves():
    lanes = Lane((0.0, 1.0)), Lane((0.1, 0.0))
    car = Player(KinematicBicycle(0.1), (Effort(1.0),))
    game = Game(tuple(replace(car, costs=(Quartic(lane),)) for lane in lanes), HORIZON, (), 0.1)
    assert members(game, [{}, {}]) == [(0,), (1,)]
    layout = layout_of(game)
    with jax.enable_x64(True):
        point, parameters = at_random(game, [{}, {}])
        point = point._replace(mult=jnp.zeros_like(point.mult))
        found = first_order(layout, point, parameters).gradient
        for i, lane in enumerate(lanes):

            def cost(place, lane=lane):
                return lane.offset(place) ** 4

            own = layout.state_slices[i].start
            places = point.x[:, own : own + 2]
            wanted = jax.vmap(jax.grad(cost))(places)
            np.testing.assert_allclose(found[:, own : own + 2], wanted, rtol=1e-9)
