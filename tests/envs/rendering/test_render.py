"""Pictures: their form, that they change, and that overlays are drawn and checked."""

from __future__ import annotations

from itertools import pairwise

import gymnasium
import numpy as np
import pytest

from foresight_env.envs import crosswalk_v0
from foresight_env.envs.rendering.overlay import Alternative, Overlay

EGO = "pedestrian_0"
ACTIONS = {EGO: np.array([-5.0, -5.0], dtype=np.float32)}
PATH = np.linspace([0.0, 2.0], [1.0, 1.0], 6)


def make(render_mode="rgb_array", **arguments):
    env = crosswalk_v0.parallel_env(
        planning_horizon=6, max_steps=10, render_mode=render_mode, **arguments
    )
    env.reset(seed=0)
    return env


def test_pictures_change_over_time_and_belong_to_the_caller():
    env = make()
    pictures = [env.render()]
    for _ in range(3):
        env.step(ACTIONS)
        pictures.append(env.render())
    for before, after in pairwise(pictures):
        assert after.dtype == np.uint8
        assert after.shape == pictures[0].shape == (620, 900, 3)
        assert (before != after).any()
    again = env.render()
    assert np.array_equal(again, pictures[-1])
    again[:] = 0
    assert np.array_equal(env.render(), pictures[-1])
    env.close()


def test_drawing_does_not_change_the_episode():
    env, plain = make(), make(None)
    for _ in range(3):
        env.render()
        env.set_overlay(Overlay(planned=PATH))
        drawn, other = env.step(ACTIONS), plain.step(ACTIONS)
        assert np.array_equal(drawn[0][EGO], other[0][EGO])


@pytest.mark.parametrize(
    "overlay",
    [
        Overlay(predicted={1: PATH}),
        Overlay(planned=PATH),
        Overlay(gammas={1: (0.7, 0.1)}),
        Overlay(truth_gammas={1: 0.6}),
        Overlay(alternatives=(Alternative("a", 0.7, {}), Alternative("b", 0.3, {1: PATH}))),
        Overlay(predicted={1: PATH[:1]}, planned=PATH[:0], gammas={0: (1.4, 3.0)}),
    ],
    ids=["predicted", "planned", "gammas", "truth", "alternatives", "degenerate"],
)
def test_overlays_are_drawn_until_reset(overlay):
    env = make()
    bare = env.render()
    env.set_overlay(overlay)
    assert (env.render() != bare).any()
    env.reset(seed=0)
    assert np.array_equal(env.render(), bare)


def test_overlays_are_copied():
    env = make()
    path = PATH.copy()
    env.set_overlay(Overlay(planned=path))
    before = env.render()
    path[:] = 0.0
    assert np.array_equal(env.render(), before)


@pytest.mark.parametrize(
    ("name", "overlay"),
    [
        ("overlay", {"planned": PATH}),
        ("planned", Overlay(planned=PATH[:, :1])),
        ("predicted", Overlay(predicted={2: PATH})),
        ("alternatives", Overlay(alternatives=(Alternative("a", 1.5, {1: PATH}),))),
        ("alternatives", Overlay(alternatives=(Alternative("a", 0.5, {2: PATH}),))),
        ("alternatives", Overlay(alternatives=("a",))),
        ("predicted", Overlay(predicted={1: PATH * np.nan})),
        ("predicted", Overlay(predicted=[PATH])),
        ("gammas", Overlay(gammas={1: 0.5})),
        ("gammas", Overlay(gammas={1: (0.5, -0.1)})),
        ("gammas", Overlay(gammas={1: "low"})),
        ("truth_gammas", Overlay(truth_gammas={1: [0.5]})),
    ],
)
def test_wrong_overlays_are_named(name, overlay):
    with pytest.raises(ValueError, match=name):
        make().set_overlay(overlay)


def test_nobody_leaves_the_picture():
    """An agent that wanders off makes the view wider: its colour stays visible."""
    states = np.array([[15.0, -12.0, 0.0, 0.0], [0.0, 2.0, 0.0, 0.0]])
    env = make()
    env.reset(seed=0, options={"initial_state": states})
    scene = env.render()[:, :640].reshape(-1, 3)
    assert (np.abs(scene.astype(int) - (0, 114, 178)).sum(axis=1) < 12).any()


def test_collisions_are_marked():
    env = make(None, controlled="all")
    env.render_mode = "rgb_array"
    states = np.array([[0.0, 0.0, 0.8, 0.0], [0.55, 0.0, -0.8, 0.0]])
    env.reset(seed=0, options={"initial_state": states})
    env.step({agent: np.zeros(2) for agent in env.agents})
    assert env.agents == []
    assert env.render().shape == (620, 900, 3)


def test_window_shows_every_step_and_closes():
    env = make("human")
    for _ in range(2):
        env.step(ACTIONS)
    assert env.render() is None
    env.close()
    env.close()
    env = gymnasium.make(
        "foresight/Crosswalk-v0", planning_horizon=6, max_steps=10, render_mode="human"
    )
    env.reset(seed=0)
    env.step(ACTIONS[EGO])
    env.close()


@pytest.mark.parametrize("driver", ["dummy", "offscreen"])
def test_a_window_that_nobody_would_see_is_refused(monkeypatch, driver):
    monkeypatch.delenv("SDL_VIDEODRIVER")
    monkeypatch.setattr("pygame.display.get_driver", lambda: driver)
    monkeypatch.setattr("pygame.display.init", lambda: None)
    with pytest.raises(OSError, match="needs a display"):
        make("human")


@pytest.mark.parametrize(("gamma", "reach"), [(1.0, 5), (0.5, 4), (0.0, 0)])
def test_plans_are_drawn_as_far_as_they_matter(gamma, reach):
    """0.5 ** 4 = 0.06 is drawn, 0.5 ** 5 = 0.03 is not."""
    env = make()
    env.reset(seed=0, options={"gamma": np.array([gamma, 0.9])})
    bare = env.render().astype(int)
    env.set_overlay(Overlay(planned=np.linspace([-0.5, 1.0], [2.5, 1.0], 6)))
    changed = np.flatnonzero((env.render() != bare).any(axis=(0, 2)))
    changed = changed[changed < 640]  # the rest is the legend
    step = 0.6 * 310 / 1.75  # pixels
    drawn = np.ptp(changed) / step if changed.size else 0.0
    assert reach - 0.1 < drawn < reach + 1.1


def test_paths_end_where_they_leave_the_picture():
    env = make()
    bare = env.render()
    away = np.array([[1.0, 1.0], [9.0, 1.0], [9.0, 0.0], [-2.0, 0.0]])
    env.set_overlay(Overlay(predicted={1: away}))
    changed = (env.render() != bare).any(axis=2)[:, :640]
    assert changed[300:320].any()  # on its way out
    assert not changed[330:].any()  # nothing of its way back


def test_render_needs_a_mode_and_an_episode():
    with pytest.warns(UserWarning, match="render_mode"):
        assert make(None).render() is None
    with pytest.raises(gymnasium.error.ResetNeeded):
        crosswalk_v0.parallel_env(render_mode="rgb_array").render()
