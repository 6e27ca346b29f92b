"""Animations of the README and of the environments' pages: `python docs/pictures.py`.

Films of development seeds, none of those that results are measured on.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import matplotlib
from PIL import Image, ImageDraw, ImageFont, ImageSequence

from evaluation.reports.episode_pictures import draw_episode, overlay_of
from evaluation.rollout.endings import ending
from evaluation.rollout.episode import episode
from evaluation.rollout.places import SETTINGS
from evaluation.rollout.setting import RunSetting
from foresight_env.envs.rendering.overlay import Overlay
from foresight_env.envs.rendering.style import COLOURS, INTERVAL_DEVIATIONS
from foresight_env.files import write_atomically

FOLDER = Path(__file__).parent / "images"
SEED = 1023
"""Of the comparison, in which `assume-gamma-1` collides."""
EGOS = {
    "assume-gamma-1": "takes every walker to look far ahead",
    "infer-gamma": "infers how far ahead each walker looks",
}
SCENE = (0, 50, 640, 606)
"""Part of a frame with the agents: left, top, right, bottom, in pixels."""
HEADER, FOOTER = 84, 120
BAR = (70, 38, 220, 16)
"""Of the first discount factor's bar within the footer: left, top, width, height, in pixels."""
SCALE = 0.75
FRAME_MILLISECONDS = 120
"""A little slower than real time, which is 100."""
HOLD_SECONDS = 2.0
"""For which the last picture stays."""
INK, RED, PAPER = "#222222", "#B22222", "#EFEEE9"


def font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Return matplotlib's DejaVu Sans, which is there wherever figures are drawn."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts/ttf", name)), size)


def frames_of(ego: str, setting: RunSetting) -> tuple[list[tuple[Image.Image, Overlay]], str]:
    """Return an episode's frames with their overlays, and its end in words."""
    env = setting.make("rgb_array")
    frames = []
    for step in episode(env, setting, ego, SEED):
        overlay = overlay_of(step, ego, setting)
        env.set_overlay(overlay)
        frames.append((Image.fromarray(env.render()), overlay))
    env.close()
    frames = frames[1:]  # from one observation nothing is inferred
    return frames, f"{ending(step.info)}\nafter {step.info['time']:.1f} s"


def panel(frame: Image.Image, overlay: Overlay, ego: str, end: str | None) -> Image.Image:
    """Return one half of the comparison: name of the ego, scene, discount factors."""
    scene = frame.crop(SCENE)
    picture = Image.new("RGB", (scene.width, HEADER + scene.height + FOOTER), PAPER)
    picture.paste(scene, (0, HEADER))
    draw = ImageDraw.Draw(picture)
    draw.text((40, 12), ego, fill=INK, font=font(26, bold=True))
    draw.text((40, 48), EGOS[ego], fill=INK, font=font(20))
    below = HEADER + scene.height
    if end is not None:
        colour = RED if end.startswith("collision") else INK
        draw.text((370, below + 30), end, fill=colour, font=font(26, bold=True))
    kind = "assumed" if ego == "assume-gamma-1" else "inferred, 90 %"
    draw.text((40, below + 6), f"gamma: {kind} (tick: true)", fill=INK, font=font(18))
    left, top, width, height = BAR
    for row, (j, true) in enumerate(overlay.truth_gammas.items()):
        y = below + top + 34 * row
        mean, deviation = overlay.gammas.get(j, (1.0, 0.0))
        draw.text((46, y - 3), str(j), fill=COLOURS[j], font=font(18, bold=True))
        draw.rectangle((left, y, left + width, y + height), fill="#D8D7D2")
        draw.rectangle((left, y, left + width * min(1.0, mean), y + height), fill=COLOURS[j])
        half = INTERVAL_DEVIATIONS * deviation
        low, high = (left + width * min(1.0, max(0.0, mean + side * half)) for side in (-1, 1))
        draw.line((low, y + height / 2, high, y + height / 2), fill=INK, width=3)
        at = left + width * true
        draw.rectangle((at - 2, y - 5, at + 2, y + height + 5), fill=INK)
    return picture


def comparison() -> Path:
    """Write the film of two egos that meet the same walkers; returns its path."""
    setting = replace(SETTINGS["crowd-3-short"], safety_filter=False)
    halves = {ego: frames_of(ego, setting) for ego in EGOS}
    length = max(len(frames) for frames, _ in halves.values())
    films = []
    for k in range(length):
        parts = [
            panel(*frames[min(k, len(frames) - 1)], ego, end if k >= len(frames) - 1 else None)
            for ego, (frames, end) in halves.items()
        ]
        gap = 16
        both = Image.new("RGB", (2 * parts[0].width + gap, parts[0].height), "white")
        for number, part in enumerate(parts):
            both.paste(part, (number * (part.width + gap), 0))
        films.append(both)
    durations = [FRAME_MILLISECONDS] * (length - 1) + [round(1e3 * HOLD_SECONDS)]
    path = FOLDER / "comparison.gif"
    write_film(path, films, durations)
    return path


def write_film(path: Path, pictures: list[Image.Image], durations: list[int]) -> None:
    """Write a film of `SCALE` times the pictures' size in 64 colours; durations in ms."""
    films = [
        picture.resize(
            (round(SCALE * picture.width), round(SCALE * picture.height)), Image.Resampling.LANCZOS
        ).quantize(64, Image.Quantize.FASTOCTREE)
        for picture in pictures
    ]
    buffer = io.BytesIO()
    films[0].save(buffer, "gif", save_all=True, append_images=films[1:], duration=durations, loop=0)
    write_atomically(path, buffer.getvalue())


def reduce(film: Path, path: Path) -> None:
    """Write a smaller film of the same pictures and durations."""
    with Image.open(film) as drawn:
        pictures, durations = [], []
        for frame in ImageSequence.Iterator(drawn):
            pictures.append(frame.convert("RGB"))
            durations.append(int(frame.info["duration"]))
    write_film(path, pictures, durations)


PLACES = {
    "crosswalk": (RunSetting("crosswalk", players=3), 1003),
    "intersection": (RunSetting("intersection"), 1000),
    "driving": (RunSetting("driving", "roundabout"), 1000),
}
"""Films of environments: the setting and the seed."""


def places() -> list[Path]:
    """Write an episode of each environment; returns the paths."""
    found = []
    for name, (setting, seed) in PLACES.items():
        drawn = draw_episode("infer-gamma", seed, setting, FOLDER / "film")
        path = FOLDER / f"{name}.gif"
        reduce(drawn.animation, path)
        for other in (FOLDER / "film").iterdir():
            other.unlink()
        (FOLDER / "film").rmdir()
        found.append(path)
    return found


if __name__ == "__main__":
    for written in (comparison(), *places()):
        print(f"{written}: {written.stat().st_size / 1e6:.2f} MB")
