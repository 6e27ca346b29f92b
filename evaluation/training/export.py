"""`foresight export`: recordings as tensors of 8 observed and 12 predicted steps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Bool, Float, Int

from evaluation.windows.complete import (
    MOST_AGENTS,
    OBSERVED,
    PREDICTED,
    CompleteWindow,
    complete_agents,
    histories_at,
)
from evaluation.windows.eth_ucy import SCENES, scene_of
from foresight_env.datasets import Recording, open_recording, read_ucy, recordings_below
from foresight_env.files import write_files


class Tensors(NamedTuple):
    """S histories of up to A = `MOST_AGENTS` agents; empty places have masks of False."""

    history: Float[np.ndarray, "S A 8 2"]
    """Observed positions, m; 0 where not observed. The last step is now."""
    history_mask: Bool[np.ndarray, "S A 8"]
    future: Float[np.ndarray, "S A 12 2"]
    """Positions to predict, m; 0 where an agent is absent."""
    future_mask: Bool[np.ndarray, "S A 12"]
    counted: Bool[np.ndarray, "S A"]
    """Agents that the protocol judges in this history: present in all 20 steps, once per window."""
    kinds: np.ndarray
    """(S, A) texts: "pedestrian", "bicycle", or a vehicle's kind; empty for an empty place."""
    agents: np.ndarray
    """(S, A) texts: ids within the recording."""
    scene: np.ndarray
    """(S,) texts: scene of ETH/UCY, of other recordings their name."""
    recording: np.ndarray
    """(S,) texts: the recording's name."""
    frame: Int[np.ndarray, "S"]
    """Frame number of the last observed step."""
    dt: Float[np.ndarray, "S"]
    """Seconds per step, as near to 0.4 s as the recording's rows allow."""


def export_recordings(data: str | Path, folder: str | Path) -> Tensors:
    """Write ``tensors.npz`` and ``steps.parquet`` into a folder and return the tensors.

    The Parquet table has a row for each agent and step with a position: `sample` and `place` are
    indices of the tensors, `step` is -7 to 0 (observed) and 1 to 12.

    Args:
        data: Folder of recordings of any format, searched with all below it, or a file.
        folder: Of the results; is made.

    Raises:
        RecordingError: no recording is there, or one is faulty.
        ValueError: no recording has a window of 20 steps.
    """
    found = [
        (recording, window)
        for recording in _recordings(data)
        for frame, agents in complete_agents(recording).items()
        for window in histories_at(recording, frame, agents)
    ]
    if not found:
        raise ValueError(f"{data}: no agent is present in {OBSERVED + PREDICTED} steps in a row")
    tensors = _stacked(found)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)

    def write_tensors(stream: BinaryIO) -> None:
        arrays: dict[str, Any] = tensors._asdict()
        np.savez_compressed(stream, allow_pickle=False, **arrays)

    table = _steps(tensors)
    write_files(
        {
            folder / "tensors.npz": write_tensors,
            folder / "steps.parquet": lambda stream: pq.write_table(table, stream),
        }
    )
    return tensors


def _recordings(data: str | Path) -> Iterator[Recording]:
    """Every recording below a folder, those of ETH/UCY with their frame rates."""
    for place, name in recordings_below(data):
        recording = open_recording(place, recording=name)
        scene = scene_of(recording.name) if recording.source == "ucy" else None
        if scene is not None and SCENES[scene].rate != recording.rate:
            file = place if place.is_file() else _file_of(place, recording.name)
            recording = read_ucy(file, rate=SCENES[scene].rate)
        yield recording


def _file_of(folder: Path, recording: str) -> Path:
    named = folder / f"{recording}_obsmat.txt"
    return named if named.exists() else folder / "obsmat.txt"


def _stacked(found: list[tuple[Recording, CompleteWindow]]) -> Tensors:
    count = len(found)
    positions = np.full((count, MOST_AGENTS, OBSERVED + PREDICTED, 2), np.nan)
    counted = np.zeros((count, MOST_AGENTS), dtype=bool)
    kinds, agents = ([[""] * MOST_AGENTS for _ in found] for _ in range(2))
    for s, (_, window) in enumerate(found):
        whole = np.concatenate([window.history.states[..., :2], window.truth])
        size = len(window.agents)
        positions[s, :size] = whole.swapaxes(0, 1)
        counted[s, :size] = window.counted
        kinds[s][:size] = window.history.kinds
        agents[s][:size] = window.agents
    mask = ~np.isnan(positions).any(axis=3)
    positions = np.where(mask[..., None], positions, 0.0)
    return Tensors(
        positions[:, :, :OBSERVED],
        mask[:, :, :OBSERVED],
        positions[:, :, OBSERVED:],
        mask[:, :, OBSERVED:],
        counted,
        np.array(kinds),
        np.array(agents),
        np.array([scene_of(r.name) or r.name for r, _ in found]),
        np.array([r.name for r, _ in found]),
        np.array([w.frame for _, w in found], dtype=np.int64),
        np.array([w.history.dt for _, w in found]),
    )


def _steps(tensors: Tensors) -> pa.Table:
    mask = np.concatenate([tensors.history_mask, tensors.future_mask], axis=2)
    positions = np.concatenate([tensors.history, tensors.future], axis=2)
    sample, place, step = np.nonzero(mask)
    return pa.table(
        {
            "scene": tensors.scene[sample],
            "recording": tensors.recording[sample],
            "frame": tensors.frame[sample],
            "sample": sample,
            "place": place,
            "agent": tensors.agents[sample, place],
            "kind": tensors.kinds[sample, place],
            "counted": tensors.counted[sample, place],
            "step": step - (OBSERVED - 1),
            "x": positions[sample, place, step, 0],
            "y": positions[sample, place, step, 1],
        }
    )
