"""Offsets from paths, lanes and gaps between bodies, against geometry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foresight_env.games import FootprintProximity, LaneBounds, PathFollowing
from foresight_env.games.paths import (
    WINDOW,
    ArcFollowing,
    FromStage,
    arc_offset,
    path_offset,
)

SPACING = 2.0


def line(angle=0.3, count=30):
    at = SPACING * np.arange(count)
    return np.column_stack(
        [at * np.cos(angle), at * np.sin(angle), np.full(count, angle), np.zeros(count)]
    )


def circle(radius, count=30):
    """To the left about (0, radius), from the origin along x."""
    turn = SPACING * np.arange(count) / radius
    return np.column_stack(
        [radius * np.sin(turn), radius * (1 - np.cos(turn)), turn, np.full(count, 1.0 / radius)]
    )


def offset(path, place):
    with jax.enable_x64(True):
        return float(path_offset(jnp.asarray(path), jnp.asarray(place, dtype=float)))


@settings(deadline=None, max_examples=25)
@given(st.floats(6.0, 50.0), st.floats(-4.0, 4.0))
def test_a_straight_path_is_exact(along, beside):
    direction = np.array([np.cos(0.3), np.sin(0.3)])
    place = along * direction + beside * np.array([-direction[1], direction[0]])
    assert offset(line(), place) == pytest.approx(beside, abs=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.floats(6.0, 40.0), st.floats(-1.5, 1.5), st.sampled_from([12.0, 20.0, 40.0]))
def test_on_a_circle_it_is_nearly_the_distance(along, beside, radius):
    """Off by no more than a twentieth of the offset and 4 cm."""
    turn = along / radius
    center = np.array([0.0, radius])
    place = center + (radius - beside) * np.array([np.sin(turn), -np.cos(turn)])
    error = offset(circle(radius), place) - beside
    assert abs(error) < 0.04 + 0.06 * abs(beside)


def test_nothing_jumps_where_the_window_moves_on():
    """Second derivatives are those of a smooth function, also between points and windows."""
    path = circle(30.0, 60)
    with jax.enable_x64(True):
        turn = np.linspace(1.5, 2.0, 400)
        places = np.column_stack([30.0 * np.sin(turn), 30.0 * (1.0 - np.cos(turn)) + 0.4])
        gradient = jax.vmap(jax.grad(lambda p: path_offset(jnp.asarray(path), p)))
        hessian = jax.vmap(jax.hessian(lambda p: path_offset(jnp.asarray(path), p)))
        first, second = np.asarray(gradient(places)), np.asarray(hessian(places))
    steps = np.diff(places, axis=0)
    middle = 0.5 * (second[1:] + second[:-1])
    expected = np.einsum("kij,kj->ki", middle, steps)
    np.testing.assert_allclose(np.diff(first, axis=0), expected, atol=1e-6)
    assert len(path) > 3 * WINDOW


def test_a_path_may_be_shorter_than_the_window():
    assert offset(line(count=3), line()[1, :2]) == pytest.approx(0.0, abs=1e-9)


def car(x, y, heading=0.0):
    return jnp.array([x, y, 5.0, heading])


def test_costs_and_constraints_by_hand():
    path = jnp.asarray(line(0.0))
    theta = {"path": path, "w": 3.0, "d": 4.0}
    with jax.enable_x64(True):
        states = (car(20.0, 0.5), car(24.0, 0.5), car(20.0, 4.0, np.pi / 2))
        cost = PathFollowing("w")(0, 1, states, (), theta)
        assert float(cost) == pytest.approx(3.0 * 0.25, rel=1e-6)
        sides = np.asarray(LaneBounds(1.0)(0, 1, states, (), theta))
        np.testing.assert_allclose(sides, [0.5, 1.5], atol=1e-6)
        # Discs of the first at x = 18.75, 21.25; of the second at 22.75, 25.25; the third stands
        # across, its discs at y = 2.75 and 5.25 above (20, .).
        gap = FootprintProximity("d", "w", reach=1.25)
        between = [
            np.hypot(a - b, c)
            for a in (18.75, 21.25)
            for b, c in ((22.75, 0.0), (25.25, 0.0), (20.0, 2.25), (20.0, 4.75))
        ]
        expected = 3.0 * sum(max(0.0, 4.0 - d) ** 2 for d in between)
        assert float(gap(0, 1, states, (), theta)) == pytest.approx(expected, rel=1e-6)
        assert float(gap(0, 1, states[:1], (), theta)) == 0.0


@settings(deadline=None, max_examples=25)
@given(st.floats(-30.0, 30.0), st.floats(-3.0, 3.0), st.sampled_from([-0.1, -1e-9, 0.0, 0.05]))
def test_offsets_from_an_arc_are_distances_to_its_circle(along, beside, curvature):
    """Of a pose anywhere; a line where the curvature is 0."""
    pose = np.array([4.0, -2.0, 0.7])
    turned = curvature * along
    # By arc length: straight on in the limit of no curvature.
    ahead = along * np.sinc(turned / np.pi)
    left = 0.5 * along * turned * np.sinc(turned / (2 * np.pi)) ** 2
    heading = pose[2] + turned
    axes = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    place = pose[:2] + axes @ np.array([ahead, left])
    place += beside * np.array([-np.sin(heading), np.cos(heading)])
    with jax.enable_x64(True):
        found = float(arc_offset(jnp.asarray(pose), jnp.asarray(curvature), jnp.asarray(place)))
    assert found == pytest.approx(beside, abs=1e-6)


def test_routes_count_from_their_stage_on():
    cost = FromStage(ArcFollowing(2.0, "curvature"))
    theta = {"anchor": np.zeros(3), "curvature": 0.0, "begin": 3.0}
    state = (jnp.array([5.0, 0.5, 1.0, 0.0]),)
    paid = [float(cost(0, t, state, (), theta)) for t in (1, 2, 3, 4)]
    assert paid == pytest.approx([0.0, 0.0, 0.5, 0.5])
