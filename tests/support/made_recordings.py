"""Recordings that the tests make themselves; no data set is needed."""

import math
from pathlib import Path

import numpy as np

from foresight_env.datasets import (
    DUT_RATE,
    UCY_RATE,
    Recording,
    Track,
    write_dut,
    write_ind,
    write_ucy,
)


def walk(
    agent_id: str,
    kind: str,
    frames: range,
    start: tuple[float, float],
    velocity: tuple[float, float],
    rate: float,
    heading: float = math.nan,
) -> Track:
    """Return a track of constant velocity that is at `start` in frame 0."""
    numbers = np.array(frames)
    position = np.array(start) + numbers[:, None] / rate * np.array(velocity)
    return Track(
        agent_id=agent_id,
        kind=kind,
        frames=numbers,
        position=position,
        velocity=np.tile(np.array(velocity, dtype=float), (numbers.size, 1)),
        heading=np.full(numbers.size, float(heading)),
    )


def random_recording(source: str, seed: int, agents: int = 4, rows: int = 12) -> Recording:
    """Return a recording that the format `source` can hold, with late entries and early leaves."""
    generator = np.random.default_rng(seed)
    rate, step = {"ind": (25.0, 1), "dut": (DUT_RATE, 1), "ucy": (UCY_RATE, 10)}[source]
    tracks = []
    for number in range(agents):
        count = int(generator.integers(2, rows + 1))
        frames = step * (int(generator.integers(0, 20)) + np.arange(count))
        vehicle = source != "ucy" and number % 2 == 0
        heading = generator.uniform(0, 6.28, count)
        velocity = generator.normal(size=(count, 2))
        if source == "dut" and vehicle:
            speed = generator.uniform(0, 9, count)
            velocity = speed[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        known = vehicle or source == "ind"
        sized = vehicle and source == "ind"
        label = {True: "veh", False: "ped"}[vehicle]
        tracks.append(
            Track(
                agent_id=f"{label}:{number}" if source == "dut" else str(number),
                kind="car" if vehicle else "pedestrian",
                frames=frames,
                position=generator.normal(size=(count, 2)) * 30,
                velocity=velocity,
                heading=heading if known else np.full(count, np.nan),
                length=4.5 if sized else math.nan,
                width=1.8 if sized else math.nan,
            )
        )
    if source == "dut":  # pedestrians come first in a recording that was read
        tracks.sort(key=lambda track: track.agent_id)
    name = {"ind": "07", "dut": "clip", "ucy": "zara"}[source]
    return Recording(name=name, source=source, rate=rate, tracks=tuple(tracks))


def write(recording: Recording, directory: Path) -> tuple[Path, ...]:
    """Write a recording in the format of its source; return its files, the main one first."""
    if recording.source == "ind":
        return write_ind(recording, directory, 7)
    if recording.source == "dut":
        return write_dut(recording, directory / "clip")
    return (write_ucy(recording, directory / "zara_obsmat.txt"),)


def assert_close(actual: Recording, expected: Recording) -> None:
    """Check that two recordings are equal but for rounding in conversions of angles."""
    assert (actual.name, actual.source, actual.rate) == (
        expected.name,
        expected.source,
        expected.rate,
    )
    assert actual.agents == expected.agents
    for one, other in zip(actual.tracks, expected.tracks, strict=True):
        assert one.kind == other.kind
        np.testing.assert_array_equal(one.frames, other.frames)
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_allclose(one.velocity, other.velocity, rtol=0, atol=1e-13)
        np.testing.assert_allclose(one.heading, other.heading, rtol=0, atol=1e-13)
        np.testing.assert_array_equal([one.length, one.width], [other.length, other.width])
