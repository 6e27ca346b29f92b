"""Networks: no order of agents preferred, trained the same way after a kill, safe files."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from agents.conformance import histories
from agents.interfaces.predictor import History
from agents.learned.crosswalk_window import crosswalk_window
from agents.learned.features import AGENTS, AHEAD, STEP, features_of, targets_of
from agents.learned.gamma import learned_gamma
from agents.learned.head import Futures, negative_log_likelihood
from agents.learned.predictor import NETWORKS, LearnedPredictor, resampled
from agents.learned.reactive import REACTIVE, ReactiveEgo
from agents.learned.training import Schedule, train
from agents.learned.weights import FOLDER, halved, load_network, packed, single, unpacked
from foresight_env.envs.crosswalk_v0 import parallel_env

MOST_BYTES = 2_000_000


def crowd(count=3, seed=0):
    random = np.random.default_rng(seed)
    velocity = random.normal(0.0, 1.0, (count, 2))
    times = STEP * np.arange(6)[:, None, None]
    states = np.zeros((6, count, 4))
    states[..., :2] = 5.0 * random.normal(size=(count, 2)) + times * velocity
    states[..., 2:] = velocity
    kinds = ("pedestrian",) * count
    return History(states, np.full((6, count), np.nan), kinds, np.full((count, 2), np.nan), STEP)


@pytest.mark.parametrize("name", NETWORKS)
def test_the_order_of_agents_does_not_matter(name):
    seen, order = crowd(), [2, 0, 1]
    other = History(
        seen.states[:, order], seen.headings[:, order], seen.kinds, seen.extents, seen.dt
    )
    mine, theirs = (LearnedPredictor(name).predict(h, 5) for h in (seen, other))
    np.testing.assert_allclose(mine.positions[:, :, order], theirs.positions, atol=1e-3)
    np.testing.assert_allclose(mine.probabilities, theirs.probabilities, atol=1e-4)


@pytest.mark.parametrize("name", NETWORKS)
def test_others_matter_and_empty_places_do_not(name):
    seen = crowd(2)
    near = History(seen.states.copy(), seen.headings, seen.kinds, seen.extents, seen.dt)
    near.states[:, 1, :2] += near.states[-1, 0, :2] - near.states[-1, 1, :2] + 0.5
    alone, together = (LearnedPredictor(name).predict(h, 5).most_likely for h in (seen, near))
    assert np.abs(alone[:, 0] - together[:, 0]).max() > 1e-3
    network, _ = load_network(
        FOLDER / f"{name}.safetensors", lambda told: NETWORKS[name](key=jax.random.key(0))
    )
    plain, _ = features_of(seen)
    noisy = plain._replace(past=plain.past.copy())
    noisy.past[2:] = 7.0  # no agent
    said = [network(f).departure[:, :2] for f in (plain, noisy)]
    np.testing.assert_allclose(*said, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_other_steps_and_many_agents(name):
    predictor, seen = LearnedPredictor(name), crowd(AGENTS + 3)
    found = predictor.predict(seen, 14)  # farther than the network was trained for
    assert found.positions.shape[1:] == (14, AGENTS + 3, 2)
    assert np.isfinite(found.covariance).all()
    coarse = predictor.predict(crowd(2), 4).most_likely
    fine = History(
        *(getattr(crowd(2), n) for n in ("states", "headings", "kinds", "extents")), STEP
    )
    np.testing.assert_array_equal(predictor.predict(fine, 8).most_likely[:4], coarse)


@pytest.mark.parametrize("name", [*NETWORKS, "gamma", *REACTIVE])
def test_shipped_weights_are_small_and_say_what_they_are(name):
    path = FOLDER / f"{name}.safetensors"
    assert path.stat().st_size < MOST_BYTES
    told = json.loads(path.with_suffix(".json").read_text())
    assert told["network"] == name
    assert told["steps" if name == "ppo" else "examples"] > 1000  # PPO tries, the others are shown


def test_features_of_a_gap_and_targets_by_hand():
    history = dict(histories())["unseen at the end"]
    seen, frames = features_of(history)
    assert seen.there.tolist() == [True] * 2 + [False] * (AGENTS - 2)
    np.testing.assert_allclose(seen.past[1, -1, :2], 0.0, atol=1e-6)  # straight on to now
    np.testing.assert_allclose(seen.past[0, :, 3], 0.0, atol=1e-6)  # along its own way
    times = history.dt * np.arange(1, 6)[:, None, None]
    truth = frames.place + times * frames.velocity
    truth[:, 0] += times[:, 0] * np.array([-frames.velocity[0, 1], frames.velocity[0, 0]])
    truth[3:, 1] = np.nan
    target, known = targets_of(frames, truth, history.dt)
    speed = np.hypot(*frames.velocity[0])
    np.testing.assert_allclose(target[0, :5, 1], STEP * speed * np.arange(1, 6), atol=1e-5)
    np.testing.assert_allclose(target[0, :5, 0], 0.0, atol=1e-5)
    np.testing.assert_allclose(target[1, :3], 0.0, atol=1e-5)
    assert known[:2].sum(axis=1).tolist() == [5, 3]


def test_likelihood_of_joint_futures_by_hand():
    """Two agents, two futures: each density is a product over agents, steps and axes."""
    departure = jnp.zeros((2, 2, AHEAD, 2)).at[1].set(1.0)
    futures = Futures(departure, jnp.full((2, 2, AHEAD, 2), 0.5), jnp.log(jnp.array([0.25, 0.75])))
    known = jnp.zeros((2, AHEAD), bool).at[:, 0].set(True)
    loss, count = negative_log_likelihood(futures, jnp.zeros((2, AHEAD, 2)), known)
    one = 1.0 / np.sqrt(2.0 * np.pi) / 0.5
    off = one * np.exp(-0.5 * 4.0)
    assert count == 2
    assert float(loss) == pytest.approx(-np.log(0.25 * one**4 + 0.75 * off**4), rel=1e-5)


def test_resampling_by_hand():
    values = np.cumsum(np.ones((1, 1, AHEAD, 2)), axis=2)
    found = resampled(values, STEP * np.array([0.5, 1.0, 2.25, AHEAD + 3.0]))
    np.testing.assert_allclose(found[0, 0, :, 0], [0.5, 1.0, 2.25, AHEAD + 3.0])


class Line(eqx.Module):
    weight: jax.Array

    def __call__(self, x):
        return self.weight * x


def line(key):
    return Line(jax.random.normal(key, (3,)))


def squared(network, example):
    x, y = example
    return jnp.sum((network(x) - y) ** 2), jnp.ones(())


def data(seed, count=40):
    x = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    return x, 2.0 * x + 1.0


SCHEDULE = Schedule(epochs=12, batch=8, rate=0.2)


def test_it_learns_and_stops_early(tmp_path):
    found = train(line, squared, data(0), data(1), tmp_path, SCHEDULE)
    losses = [e.validation for e in found.curve]
    assert losses[found.best] == min(losses) < 0.5 * losses[0]
    np.testing.assert_allclose(found.network.weight, 2.0, atol=0.5)
    impatient = replace(SCHEDULE, epochs=500, patience=2)
    stopped = train(line, squared, data(0), data(1), tmp_path / "other", impatient)
    assert len(stopped.curve) < 500
    assert len(stopped.curve) - 1 - stopped.best == 2


def test_only_what_is_trainable_changes(tmp_path):
    def pair(key):
        return line(key), line(jax.random.fold_in(key, 1))

    def loss(network, example):
        x, y = example
        return jnp.sum((network[0](x) + network[1].weight - y) ** 2), jnp.ones(())

    def second_alone(network):
        return jax.tree.map(lambda _: False, network[0]), jax.tree.map(eqx.is_array, network[1])

    found = train(pair, loss, data(0), data(1), tmp_path, SCHEDULE, trainable=second_alone)
    start = pair(jax.random.split(jax.random.key(SCHEDULE.seed))[0])
    np.testing.assert_array_equal(found.network[0].weight, start[0].weight)
    assert float(jnp.max(jnp.abs(found.network[1].weight - start[1].weight))) > 0.1


def test_weights_of_half_precision_are_read_in_single():
    tree = {"a": jnp.array([0.1, -3.0]), "count": jnp.array([3])}
    data = packed(halved(tree))
    assert len(data) < len(packed(tree))
    again = unpacked(tree, data, "file")
    assert again["a"].dtype == jnp.float32
    np.testing.assert_array_equal(again["a"], single(halved(tree))["a"])
    np.testing.assert_allclose(again["a"], tree["a"], rtol=1e-3)
    np.testing.assert_array_equal(again["count"], tree["count"])


def test_a_training_that_was_interrupted_ends_the_same(tmp_path):
    whole = train(line, squared, data(0), data(1), tmp_path / "whole", SCHEDULE)

    def interrupt(epoch):
        if epoch.number == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(line, squared, data(0), data(1), tmp_path / "part", SCHEDULE, on_epoch=interrupt)
    again = train(line, squared, data(0), data(1), tmp_path / "part", SCHEDULE)
    assert again.curve == whole.curve
    assert packed(again.network) == packed(whole.network)


KILLED = """
import sys, time
from pathlib import Path
from tests.agents.learned.test_learned import SCHEDULE, data, line, squared, train
print("begun", flush=True)
train(line, squared, data(0), data(1), Path(sys.argv[1]), SCHEDULE,
      on_epoch=lambda e: time.sleep(0.05))
"""


def test_a_training_that_was_killed_ends_the_same(tmp_path):
    whole = train(line, squared, data(0), data(1), tmp_path / "whole", SCHEDULE)
    script = [sys.executable, "-c", KILLED]
    process = subprocess.Popen([*script, str(tmp_path / "killed")], stdout=subprocess.PIPE)
    file = tmp_path / "killed" / "checkpoint.safetensors"
    while not file.exists() and process.poll() is None:
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    again = train(line, squared, data(0), data(1), tmp_path / "killed", SCHEDULE)
    assert again.curve == whole.curve
    assert packed(again.network) == packed(whole.network)


def test_a_folder_of_another_training_is_refused(tmp_path):
    train(line, squared, data(0), data(1), tmp_path, SCHEDULE)
    with pytest.raises(ValueError, match="other data or another schedule"):
        train(line, squared, data(2), data(1), tmp_path, SCHEDULE)
    file = tmp_path / "checkpoint.safetensors"
    file.write_bytes(file.read_bytes()[:-7])
    with pytest.raises(ValueError, match="is damaged"):
        train(line, squared, data(0), data(1), tmp_path, SCHEDULE)
    with pytest.raises(ValueError, match="examples: are none"):
        train(line, squared, data(0, 0), data(1), tmp_path / "none", SCHEDULE)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_rate_that_is_too_large_is_told(tmp_path):
    with pytest.raises(ValueError, match="use a smaller rate than 1e"):
        train(line, squared, data(0), data(1), tmp_path, replace(SCHEDULE, rate=1e30))


def test_wrong_files_are_told(tmp_path):
    mine = LearnedPredictor("transformer", str(tmp_path / "mine.safetensors"))
    with pytest.raises(ValueError, match="is missing; train it"):
        mine.predict(crowd(), 3)
    (tmp_path / "mine.safetensors").write_bytes(b"nonsense")
    (tmp_path / "mine.json").write_text('{"network": "transformer", "calibration": 1.0}')
    with pytest.raises(ValueError, match="is damaged"):
        mine.predict(crowd(), 3)
    (tmp_path / "mine.safetensors").write_bytes((FOLDER / "social-lstm.safetensors").read_bytes())
    with pytest.raises(ValueError, match="is of another network"):
        mine.predict(crowd(), 3)


def test_the_learned_gamma_tells_the_far_from_the_short_sighted():
    """Of episodes that differ in the other's discount factor alone."""
    found = {}
    for gamma in (0.35, 0.95):
        env = parallel_env(controlled="all", noise_std=0.0)
        from agents import make_ego

        observations, infos = env.reset(seed=3, options={"gamma": [0.95, gamma]})
        policy = make_ego("oracle")
        memories = {a: policy.init(env.scene, a) for a in env.agents}
        states = []
        for _ in range(14):
            states.append(infos["pedestrian_0"]["state"])
            actions = {}
            for agent in env.agents:
                memory = policy.update(memories[agent], observations[agent], infos[agent])
                decision, memories[agent] = policy.act(memory)
                actions[agent] = decision.action
            observations, *_, infos = env.step(actions)
        found[gamma] = learned_gamma(np.stack(states[-10:]))
    assert found[0.35][0] < found[0.95][0] - 0.3
    assert all(0.0 < deviation < 0.5 for _, deviation in found.values())
    with pytest.raises(ValueError, match=r"observed: has shape \(3, 2, 4\)"):
        learned_gamma(np.zeros((3, 2, 4)))
    with pytest.raises(ValueError, match="observed: holds NaN"):
        learned_gamma(np.full((10, 2, 4), np.nan))


def test_the_cloned_ego_knows_where_it_may_be():
    env = parallel_env(players=3)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="expected the crosswalk with players=2"):
        ReactiveEgo("cloned").init(env.scene, "pedestrian_0")
    env = parallel_env()
    env.reset(seed=0)
    memory = ReactiveEgo("cloned").init(env.scene, "pedestrian_0")
    with pytest.raises(ValueError, match="call update before act"):
        ReactiveEgo("cloned").act(memory)
    window = crosswalk_window(np.arange(20.0).reshape(2, 10))
    np.testing.assert_array_equal(window[0], window[2])
    np.testing.assert_array_equal(window[3, :2], 0.0)
    np.testing.assert_array_equal(window[3, 2:4], [12.0, 13.0])
