"""The ETH/UCY protocol: every predictor on every window of the scenes, one row each.

Windows, histories and velocities follow `evaluation.windows.complete`; scenes are those of
`evaluation.windows.eth_ucy`. A learned predictor is given weights for each scene, trained on the
other ones (leave one out).
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

import agents
from agents.interfaces.predictor import Forecast, History
from agents.registry import LEARNED, make_predictor, weights_file
from evaluation.execution.local import Workers
from evaluation.execution.provenance import fingerprint
from evaluation.execution.runner import run_trials
from evaluation.execution.store import Row, Store, Trial
from evaluation.metrics.calibration import BINS, level_counts
from evaluation.metrics.prediction import overlaps
from evaluation.metrics.trajectory import (
    MISS_DISTANCE,
    best_of_agents,
    negative_log_likelihood,
)
from evaluation.studies.prediction import digest_of, warm_up
from evaluation.windows import complete as windows
from evaluation.windows.complete import (
    LEAST_AGENTS,
    PREDICTED,
    CompleteWindow,
    complete_agents,
    histories_at,
)
from evaluation.windows.eth_ucy import SCENES, read_scene_file, scene_files

STUDY = "eth-ucy"
KEY = ("scene", "recording", "content", "frame", "predictor", "settings")
RULE = ("OBSERVED", "PREDICTED", "LEAST_AGENTS", "LEAST_OBSERVED", "REACH", "MOST_AGENTS")
FUTURES = 20
"""Of how many of the most likely futures the best counts."""
WEIGHTS = Path(agents.__file__).parent / "learned" / "shipped" / "eth_ucy"
"""Folder with a folder of weights for each scene, of the library's networks."""


def run_window(
    scene: str,
    recording: str,
    content: str,
    frame: int,
    predictor: str,
    settings: str,
    path: str,
    counted: Sequence[str],
    weights: str | None,
) -> Row:
    """One predictor's row for one window: lists with an entry for each agent that counts."""
    row: dict[str, Any] = {
        name: [] for name in ("agents", "ade", "fde", "best_ade", "best_fde", "missed", "nll")
    }
    row |= {"seconds": [], "overlaps": 0, "overlaps_recorded": 0, "fallbacks": 0}
    levels = np.zeros(BINS, dtype=int)
    made = make_predictor(predictor, weights)
    for window in histories_at(read_scene_file(path, scene), frame, counted):
        history = window.history
        warm_up(predictor, history.kinds, len(history.states), PREDICTED, history.dt, weights)
        begin = time.perf_counter()
        forecast = made.predict(history, PREDICTED)
        row["seconds"].append(time.perf_counter() - begin)
        for name, value in judged_agents(window, forecast).items():
            row[name] += value
        row["fallbacks"] += int(forecast.fallback)
        levels += _levels(window, forecast)
    row["levels"] = levels.tolist() if levels.any() else None
    row["nll"] = row["nll"] or None
    return row


def judged_agents(window: CompleteWindow, forecast: Forecast) -> dict[str, Any]:
    """Metrics of the agents that count in a history, by name: lists in their order, and sums.

    `ade`, `fde`: of the most likely future. `best_ade`, `best_fde`: minADE_20 and minFDE_20, each
    agent and metric by itself. `nll`: nothing where the forecast has no covariances.
    """
    own = np.flatnonzero(window.counted)
    truth, path = window.truth[:, own], forecast.most_likely[:, own]
    gap = np.linalg.norm(path - truth, axis=2)
    best = best_of_agents(forecast.positions[:, :, own], forecast.probabilities, truth, FUTURES)
    counted = _restricted(window.history, own)
    return {
        "agents": [window.agents[i] for i in own],
        "ade": gap.mean(axis=0).tolist(),
        "fde": gap[-1].tolist(),
        "best_ade": best.average.tolist(),
        "best_fde": best.final.tolist(),
        "missed": [int(far) for far in gap[-1] > MISS_DISTANCE],
        "nll": _likelihoods(forecast, own, truth),
        "overlaps": overlaps(counted, path),
        "overlaps_recorded": overlaps(counted, truth),
    }


def _likelihoods(
    forecast: Forecast, own: np.ndarray, truth: Float[np.ndarray, "P A 2"]
) -> list[float]:
    if forecast.covariance is None:
        return []
    present = np.ones((len(truth), 1), dtype=bool)
    return [
        negative_log_likelihood(
            forecast.positions[:, :, [i]],
            forecast.probabilities,
            forecast.covariance[:, :, [i]],
            truth[:, [k]],
            present,
        )
        for k, i in enumerate(own)
    ]


def _levels(window: CompleteWindow, forecast: Forecast) -> np.ndarray:
    own = np.flatnonzero(window.counted)
    if forecast.covariance is None:
        return np.zeros(BINS, dtype=int)
    truth = window.truth[:, own]
    present = np.ones(truth.shape[:2], dtype=bool)
    return np.array(
        level_counts(
            forecast.positions[:, :, own],
            forecast.probabilities,
            forecast.covariance[:, :, own],
            truth,
            present,
        )
    )


def _restricted(history: History, own: np.ndarray) -> History:
    """The same history of fewer agents."""
    return History(
        history.states[:, own],
        history.headings[:, own],
        tuple(history.kinds[i] for i in own),
        history.extents[own],
        history.dt,
    )


def study(
    folder: str | Path,
    data: str | Path,
    predictors: Sequence[str],
    *,
    scenes: Sequence[str] = tuple(SCENES),
    weights: str | Path | None = None,
    every: int = 1,
    workers: Workers = None,
    fresh: bool = False,
) -> list[Row]:
    """Run the protocol in `folder` on the scenes' files below `data` and return its rows.

    Args:
        folder: Of results; windows that it has already are not run again.
        data: Folder with the scenes' ``obsmat.txt`` files.
        predictors: Names that the registry makes.
        scenes: Of `SCENES`.
        weights: Folder with a folder for each scene of weights that were trained without it:
            networks of the library read `SCENE/NAME.safetensors`, your own class is given the
            scene's folder (`make_predictor`). None: `WEIGHTS` for the former, nothing for yours.
        every: Take every n-th window that counts; 1 is the protocol.
        workers: Processes.
        fresh: Delete earlier results.

    Raises:
        RecordingError: a file is missing or faulty.
        ValueError: a scene or predictor is unknown, or a learned predictor has no weights for a
            scene.
    """
    unknown = [name for name in scenes if name not in SCENES]
    if unknown:
        raise ValueError(f"scenes: {unknown[0]!r} is unknown; choose from {', '.join(SCENES)}")
    folders = {name: _folder(name, weights) for name in predictors}
    settings = {name: _settings(name, folder, scenes) for name, folder in folders.items()}
    files = [(scene, path) for scene in scenes for path in scene_files(data, scene)]
    rule = {name: getattr(windows, name) for name in RULE} | {"futures": FUTURES}
    trials: list[Trial] = []
    for scene, path in files:
        recording = read_scene_file(str(path), scene)
        complete = complete_agents(recording)
        frames = [frame for frame, names in complete.items() if len(names) >= LEAST_AGENTS]
        content = digest_of(recording)
        trials += [
            {
                "scene": scene,
                "recording": recording.name,
                "content": content,
                "frame": frame,
                "predictor": name,
                "settings": settings[name],
                "path": str(path),
                "counted": complete[frame],
                "weights": None if folder is None else str(folder / scene),
            }
            for frame in frames[::every]
            for name, folder in folders.items()
        ]
    if not trials:
        raise ValueError(f"--data: no window of 20 steps in the scenes of {data}")
    store = Store(folder, STUDY, rule, KEY, fresh=fresh)
    return run_trials(
        run_window,
        trials,
        store,
        workers=workers,
        label="windows",
        chunk=128,
        programs=("predictor",),
    )


def _folder(name: str, weights: str | Path | None) -> Path | None:
    """Folder of a predictor's weights, with a folder for each scene."""
    if weights is not None:
        return Path(weights)
    return WEIGHTS if name in LEARNED else None


def _settings(name: str, folder: Path | None, scenes: Sequence[str]) -> str:
    """A predictor's settings, with a digest of its weights for each scene.

    Raises:
        ValueError: it cannot be made, or is a network of the library without weights for a scene.
    """
    if folder is None:
        return fingerprint(make_predictor(name))
    for scene in scenes:
        if name in LEARNED:
            _check_weights(folder, scene, name)
    made = (make_predictor(name, folder / scene).name for scene in scenes)
    own = {weights_file(folder, each).stem for each in made}
    files = {
        scene: sorted(path for n in own for path in (folder / scene).glob(f"{n}.*"))
        for scene in SCENES
    }
    used = {
        scene: [[p.name, hashlib.sha256(p.read_bytes()).hexdigest()[:16]] for p in paths]
        for scene, paths in files.items()
        if paths
    }
    if not used:
        return fingerprint(make_predictor(name))
    return json.dumps({"predictor": name, "weights": used})


def _check_weights(folder: Path, scene: str, name: str) -> None:
    """Check that a network of the library has weights that were trained without a scene."""
    path = weights_file(folder / scene, name)
    if path.is_file():
        return
    raise ValueError(
        f"{path}: is missing; {name} needs weights trained without {scene}: "
        f"foresight train {path.stem} --data DIR --hold-out {scene} --out OUT makes them, in "
        f"OUT/{scene}/{path.stem}; copy them there, or name another folder of weights"
    )
