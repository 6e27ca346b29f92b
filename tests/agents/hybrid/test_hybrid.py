"""The network, the window's inverse game and the predictor: invariances, and known answers."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agents.egos.predict_then_plan import history_of
from agents.hybrid.augmentation import augmented
from agents.hybrid.futures import GameUse, deviations, joint_futures, play
from agents.hybrid.loss import Example, futures_loss
from agents.hybrid.network import MODES, ProposalNetwork, ranked, traits_of
from agents.hybrid.predictor import SIMULATED, HybridPredictor
from agents.hybrid.scene import RECENT, scene_of, smoothed, targets
from agents.hybrid.smooth_game import SmoothGame, equilibrium, positions
from agents.hybrid.strategies import GAME_BASIS, HORIZON, STEPS, strategy_basis
from agents.hybrid.window import explained
from agents.interfaces.predictor import Context, History
from agents.learned.features import STEP
from agents.learned.weights import FOLDER
from foresight_env.envs import scene_of as scene_of_env
from foresight_env.envs.crosswalk_v0 import parallel_env

PLACES = 4
EQUILIBRIUM = jax.jit(equilibrium)
WINDOW = jax.jit(explained)


def walkers(seed=0, steps=8, kinds=("pedestrian",) * 3, gap=1.5):
    """Agents in straight motion who come close to each other."""
    random = np.random.default_rng(seed)
    count = len(kinds)
    angle = 2.0 * np.pi * (np.arange(count) / count + 0.05 * random.random(count))
    velocity = np.stack([np.cos(angle), np.sin(angle)], axis=1) * random.uniform(
        0.8, 1.4, (count, 1)
    )
    times = STEP * (np.arange(steps) - (steps - 1))
    states = np.zeros((steps, count, 4))
    states[..., :2] = -gap * velocity + times[:, None, None] * velocity
    states[..., 2:] = velocity
    blank = np.full((steps, count), np.nan)
    return History(states, blank, kinds, np.full((count, 2), np.nan), STEP)


def network(seed=0):
    """Random, and with proposals that differ."""
    anchors = 0.3 * np.random.default_rng(seed).normal(size=(MODES, 8))
    return ProposalNetwork(key=jax.random.key(seed), anchors=anchors)


def moved(history, turn, shift):
    """The same history in other axes."""
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    states = history.states.copy()
    states[..., :2] = states[..., :2] @ rotation.T + shift
    states[..., 2:] = states[..., 2:] @ rotation.T
    return replace(history, states=states)


@partial(jax.jit, static_argnames="use")
def solved_futures(scene, use=GameUse()):
    """Futures of the random network, and their paths."""
    found = joint_futures(network(), scene, use)
    return found, jax.vmap(lambda z: positions(scene.frames, z, GAME_BASIS))(found.strategy)


def paths(history, use=GameUse(), places=PLACES):
    scene, middle = scene_of(history, places)
    found, path = solved_futures(scene, use)
    return np.asarray(path)[:, : len(history.kinds)] + middle, found


def test_futures_turn_and_move_with_the_plane():
    history = walkers()
    mine, first = paths(history)
    turn, shift = 0.7, np.array([100.0, -40.0])
    theirs, second = paths(moved(history, turn, shift))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    np.testing.assert_allclose(theirs, mine @ rotation.T + shift, atol=5e-3)
    np.testing.assert_allclose(first.logits, second.logits, atol=5e-2)


def test_empty_places_and_the_order_of_agents_do_not_matter():
    history, order = walkers(), [2, 0, 1]
    mine, _ = paths(history)
    wide, _ = paths(history, places=8)
    np.testing.assert_allclose(wide, mine, atol=2e-3)
    other = replace(history, states=history.states[:, order])
    theirs, _ = paths(other)
    np.testing.assert_allclose(theirs, mine[:, order], atol=2e-3)


def test_the_central_future_is_first_and_the_most_likely():
    scene, _ = scene_of(walkers(), PLACES)
    proposals = network()(scene)
    found, joint = ranked(proposals, jnp.asarray(scene.bodies.there))
    np.testing.assert_allclose(found.preferred[0], proposals.preferred[0])
    own = np.asarray(found.logits)[:, :3]
    assert (np.diff(own, axis=0) <= 1e-6).all()
    assert int(jnp.argmax(joint)) == 0
    np.testing.assert_allclose(jnp.exp(joint).sum(), 1.0, atol=1e-5)
    assert int(jnp.argmax(paths(walkers())[1].logits)) == 0


def test_games_keep_agents_apart_that_their_proposals_do_not():
    history = walkers(gap=1.5)
    scene, _ = scene_of(history, PLACES)
    frames = scene.frames
    traits = traits_of(jnp.tile(jnp.array([2.0, -2.0, 1.1, -0.4]), (PLACES, 1)))
    straight = jnp.zeros((PLACES, 4, 2))
    found = EQUILIBRIUM(SmoothGame(frames, scene.bodies, traits, straight), GAME_BASIS)
    assert found.solved

    def least(strategy):
        path = positions(frames, strategy, GAME_BASIS)[:3]
        gap = jnp.linalg.norm(path[:, None] - path[None], axis=-1)
        return float(jnp.min(gap + 9.0 * jnp.eye(3)[..., None]))

    assert least(straight) < 0.3
    assert least(found.strategy) > least(straight) + 0.2


@pytest.mark.parametrize("polite", [True, False])
def test_the_window_prefers_the_traits_that_it_was_made_with(polite):
    """Positions of a solved game, of agents who make way for each other or do not."""
    history = walkers(gap=0.0)  # they meet in the window
    history.states[:, :, 0] += np.array([0.0, 0.5, -0.3])
    history.states[:, :, 1] += np.array([0.3, 0.0, 0.0])
    scene, _ = scene_of(history, PLACES)
    start = scene.start
    makes_way = jnp.tile(jnp.array([1.0, -2.0, 1.1, -0.7]), (PLACES, 1))
    ignores = makes_way.at[:, 2].set(-6.0)
    truth, other = (makes_way, ignores) if polite else (ignores, makes_way)
    game = SmoothGame(start, scene.bodies, traits_of(truth), jnp.zeros((PLACES, 4, 2)))
    solved = EQUILIBRIUM(game, GAME_BASIS)
    assert solved.solved
    made = positions(start, solved.strategy, GAME_BASIS)[:, :7]
    window = jnp.concatenate([start.place[:, None], made], axis=1)
    scene = scene._replace(window=np.asarray(window))
    noise = jnp.asarray(0.02)
    right, wrong = (WINDOW(scene, numbers, noise) for numbers in (truth, other))
    assert float(right.evidence) > float(wrong.evidence) + 2.0
    for found in (right, wrong):
        assert (np.asarray(found.deviation) <= 1.0 + 1e-5).all()
    if not polite:
        # Corrections go towards the truth; from the least conflict weight they cannot.
        towards = np.asarray(wrong.numbers)[:3, 2] - np.asarray(other)[:3, 2]
        assert towards.min() < -0.1


def test_without_inference_discount_factors_are_one():
    scene, _ = scene_of(walkers(), PLACES)
    found, _ = solved_futures(scene, GameUse(infer=False))
    np.testing.assert_allclose(found.traits.gamma, 1.0, atol=1e-6)
    inferred, _ = solved_futures(scene)
    assert (np.asarray(inferred.traits.gamma) < 0.99).all()


def test_a_game_that_fails_leaves_the_proposal():
    scene, _ = scene_of(walkers(), PLACES)
    proposals = network()(scene)
    broken = proposals._replace(traits=proposals.traits.at[..., 2].set(jnp.nan))
    made = jax.jit(play, static_argnames="use")
    found = made(broken, scene, use=GameUse(window=False))
    alone = made(proposals, scene, use=GameUse(game=False))
    assert np.isfinite(np.asarray(found.strategy)[:, :3]).all()
    assert not np.asarray(found.solved).any() or np.isfinite(found.logits).all()
    np.testing.assert_allclose(found.preferred[:, :3], alone.preferred[:, :3])


def test_the_loss_has_finite_derivatives_and_falls_along_its_gradient():
    history = walkers()
    scene, middle = scene_of(history, PLACES)
    truth = history.states[-1, :, :2] + STEP * np.arange(1, 13)[:, None, None] * (
        history.states[-1, :, 2:] + 0.2
    )
    example = Example(scene, *targets(scene, middle, truth, STEP, STEPS))
    start = network()

    @eqx.filter_jit
    @eqx.filter_value_and_grad
    def loss(model, example):
        total, count = futures_loss(model, example, GameUse())
        return total / count

    value, slope = loss(start, example)
    flat = jnp.concatenate([v.ravel() for v in jax.tree.leaves(eqx.filter(slope, eqx.is_array))])
    assert np.isfinite(np.asarray(flat)).all()
    step = 1e-3 / float(jnp.linalg.norm(flat))
    nearer = eqx.apply_updates(start, jax.tree.map(lambda v: -step * v, slope))
    assert float(loss(nearer, example)[0]) < float(value)
    changed = augmented(example, jax.random.key(1))
    assert np.isfinite(float(loss(start, changed)[0]))


@pytest.mark.parametrize("seed", range(4))
def test_augmentation_is_a_change_of_axes_and_length(seed):
    """Features and frames of the changed scene are those of the changed tracks."""
    history = walkers(seed)
    history.states[2, :, :2] += 0.1  # not straight: velocities change
    scene, middle = scene_of(history, PLACES)
    truth = np.repeat(history.states[-1:, :, :2], STEPS, axis=0)
    example = Example(scene, *targets(scene, middle, truth, STEP, STEPS))
    found = augmented(example, jax.random.key(seed))
    size = float(
        jnp.linalg.norm(found.scene.frames.velocity[0]) / np.linalg.norm(scene.frames.velocity[0])
    )
    side = float(found.scene.frames.place[0, 1] / scene.frames.place[0, 1]) / size
    states = history.states * np.array([size, side * size, size, side * size])
    again, _ = scene_of(replace(history, states=states), PLACES)
    for got, wanted in zip(found.scene.frames, again.frames, strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-4)
    np.testing.assert_allclose(found.scene.seen.others, again.seen.others, atol=1e-4)
    np.testing.assert_allclose(found.scene.seen.kind, again.seen.kind, atol=1e-4)
    np.testing.assert_allclose(found.scene.roughness, again.roughness, atol=1e-4)
    kept = np.asarray(found.scene.seen.past)[..., 4] > 0.5
    np.testing.assert_allclose(
        np.where(kept[..., None], found.scene.seen.past, 0.0),
        np.where(kept[..., None], again.seen.past, 0.0),
        atol=1e-4,
    )


def test_strategies_are_orthonormal_smooth_and_straight_at_the_end():
    value = GAME_BASIS.value.astype(float)
    np.testing.assert_allclose(value.T @ value / STEPS, np.eye(4), atol=1e-5)
    times = np.array([1.0, 1.0 + 1e-2, 1.0 - 1e-2, HORIZON, HORIZON + 1.0, HORIZON + 2.0])
    basis = strategy_basis(times)
    middle, after, before = basis.value[:3].astype(float)
    bent = (after - 2.0 * middle + before) / 1e-4
    np.testing.assert_allclose(bent, basis.acceleration[0], rtol=2e-2, atol=2e-2)
    np.testing.assert_allclose(
        basis.value[5] - basis.value[4], basis.value[4] - basis.value[3], atol=1e-5
    )
    spread = jnp.array([0.1, 0.2, 0.0, 0.0])
    grown = deviations(spread, strategy_basis(np.array([HORIZON])))
    np.testing.assert_allclose(grown[0], [0.13, 0.23], atol=1e-5)


def test_weights_are_those_of_episodes_where_the_game_is_known():
    env = parallel_env(noise_std=0.0)
    env.reset(seed=0)
    scene = scene_of_env(env)
    rows = np.zeros((4, 2, 4))
    rows[:, 0, 0] = STEP * np.arange(4)
    rows[:, :, 2] = 1.0
    history = replace(history_of(scene, tuple(rows)), dt=STEP)
    assert history.context.game is not None

    def path(weights):
        return HybridPredictor(weights=weights, game="none").predict(history, 5).most_likely

    folders = {name: FOLDER / name / "hybrid-game.safetensors" for name in ("", SIMULATED)}
    np.testing.assert_array_equal(path(""), path(str(folders[SIMULATED])))
    assert np.abs(path("") - path(str(folders[""]))).max() > 1e-3
    recorded = replace(history, context=replace(history.context, game=None))
    np.testing.assert_array_equal(
        HybridPredictor(game="none").predict(recorded, 5).most_likely, path(str(folders[""]))
    )


def test_the_last_velocity_is_a_mean_of_the_last_ones():
    history = walkers()
    history.states[-1, 0, 2:] = 5.0
    found = smoothed(history)
    before = history.states[-2, 0, 2:]
    np.testing.assert_allclose(found.states[-1, 0, 2:], RECENT[0] * 5.0 + (1 - RECENT[0]) * before)
    np.testing.assert_array_equal(found.states[:-1], history.states[:-1])


def test_roughness_by_hand():
    """Second differences: 0, 0.2 and 0.4 m of the first, none of the others."""
    history = walkers(steps=5)
    history.states[1:, 0, 0] += np.array([0.0, 0.0, 0.2, 0.8])
    history.states[:3, 1] = np.nan  # observed twice: the scene's stands for its own
    scene, _ = scene_of(history, PLACES)
    np.testing.assert_allclose(scene.roughness[:3], [[0.2, 0.0], [0.0, 0.0], [0.0, 0.0]], atol=1e-5)
    np.testing.assert_array_equal(scene.roughness[3], 0.0)
    half, _ = scene_of(replace(history, dt=2.0 * STEP), PLACES)
    np.testing.assert_allclose(half.roughness[0, 0], 0.05, atol=1e-5)


def test_roughness_of_noise_does_not_depend_on_the_step():
    fine = walkers(steps=29)
    fine.states[..., :2] *= 0.25
    fine.states[..., :2] += 0.05 * np.random.default_rng(0).standard_normal((29, 3, 2))
    blank = np.full((8, 3), np.nan)
    coarse = replace(fine, states=fine.states[::4].copy(), headings=blank)
    first, _ = scene_of(replace(fine, dt=0.25 * STEP), PLACES)
    second, _ = scene_of(coarse, PLACES)
    np.testing.assert_allclose(first.roughness, second.roughness, rtol=1e-5)


def test_the_share_of_the_central_departure():
    scene, _ = scene_of(walkers(), PLACES)
    kinematic = np.asarray(scene.kinematic)
    whole, half, none = (
        eqx.tree_at(lambda n: n.share, network(), jnp.asarray(share))(scene).preferred
        for share in (1.0, 0.5, 0.0)
    )
    np.testing.assert_allclose(none[0], kinematic, atol=1e-5)
    np.testing.assert_allclose(half[0], 0.5 * (whole[0] + kinematic), atol=1e-5)
    np.testing.assert_array_equal(half[1:], whole[1:])


def test_routes_ahead_are_in_the_drivers_axes():
    history = walkers(kinds=("car", "pedestrian"))
    place, velocity = history.states[-1, 0, :2], history.states[-1, 0, 2:]
    along = velocity / np.hypot(*velocity)
    distance = np.arange(-10.0, 60.0)
    angle = np.arctan2(along[1], along[0])
    route = np.concatenate(
        [place + distance[:, None] * along, np.full((70, 1), angle), np.zeros((70, 1))], axis=1
    )
    with_route = replace(history, context=Context((route,), np.ones(1)))
    scene, _ = scene_of(with_route, PLACES)
    points = scene.routes[0, 0, :-1].reshape(-1, 2)
    np.testing.assert_allclose(points[:, 0], [0.4, 0.8, 1.6, 2.4, 3.2], atol=1e-3)
    np.testing.assert_allclose(points[:, 1], 0.0, atol=1e-3)
    assert scene.routes[0, 0, -1] == 1.0
    assert scene.routes[0, 1, -1] == 0.0
    assert not scene.routes[1].any()
