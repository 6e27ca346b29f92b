"""One episode as an animation, a still and a curve."""

from __future__ import annotations

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from evaluation.reports.figures import gamma_over_time
from evaluation.rollout.episode import Step, episode, inferred
from evaluation.rollout.setting import RunSetting
from foresight_env.envs.rendering.overlay import Alternative, Overlay
from foresight_env.files import write_atomically


class EpisodePictures(NamedTuple):
    """An episode and the files that show it."""

    steps: list[Step]
    animation: Path
    still: Path
    curve: Path | None
    """Inferred discount factors over time; None for egos that infer none."""


def overlay_of(step: Step, ego: str, setting: RunSetting) -> Overlay:
    """Overlay of the registered ego at this step."""
    decision, truth = step.decision, setting.true_gammas(step.info)
    return Overlay(
        predicted=dict(decision.predicted),
        planned=decision.planned,
        gammas=inferred(ego, decision),
        alternatives=tuple(Alternative(*hypothesis) for hypothesis in decision.hypotheses),
        intervention=decision.intervention,
        truth_gammas={j: float(truth[j]) for j in decision.gammas if not np.isnan(truth[j])},
    )


def _reduced(frame: Image.Image) -> Image.Image:
    """To few colours; median cut would draw an agent of few pixels in the colour of another."""
    return frame.quantize(128, Image.Quantize.FASTOCTREE)


def draw_episode(ego: str, seed: int, setting: RunSetting, folder: Path) -> EpisodePictures:
    """Run one episode and write `episode.gif`, `episode.png` and `gammas.png` into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    env = setting.make("rgb_array")
    frames, steps = [], []
    try:
        for step in episode(env, setting, ego, seed):
            env.set_overlay(overlay_of(step, ego, setting))
            frames.append(Image.fromarray(env.render()))
            steps.append(step)
    finally:
        env.close()
    dt = env.scene.dt
    still = frames[min(round(setting.middle / dt), len(frames) - 1)]
    paths = folder / "episode.gif", folder / "episode.png"
    buffer = io.BytesIO()
    small = [_reduced(f.resize((f.width * 2 // 3, f.height * 2 // 3))) for f in frames]
    small[0].save(
        buffer, "gif", save_all=True, append_images=small[1:], duration=round(1e3 * dt), loop=0
    )
    write_atomically(paths[0], buffer.getvalue())
    buffer = io.BytesIO()
    still.save(buffer, "png")
    write_atomically(paths[1], buffer.getvalue())
    curve = None
    gammas = [inferred(ego, s.decision) for s in steps]
    if any(gammas):
        times = dt * np.arange(len(steps))
        true = setting.true_gammas(steps[0].info)
        curve = gamma_over_time(times, gammas, true, folder / "gammas.png")
    return EpisodePictures(steps, paths[0], paths[1], curve)
