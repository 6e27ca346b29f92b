"""Scenes of the ETH/UCY protocol: which files they are, and their frame rates.

ETH: Pellegrini et al., ICCV 2009 (scenes eth and hotel). UCY: Lerner et al., Computer Graphics
Forum 2007 (univ, zara1, zara2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from foresight_env.datasets import Recording, RecordingError, read_ucy


@dataclass(frozen=True)
class Scene:
    """One scene of the protocol."""

    recordings: tuple[tuple[str, ...], ...]
    """Recordings that it consists of, each by the names that it has in common collections."""
    rate: float
    """Frame numbers per second."""
    optional: int = 0
    """How many recordings, counted from the end, may be missing."""


SCENES = {
    "eth": Scene((("eth", "seq_eth"),), 15.0),
    "hotel": Scene((("hotel", "seq_hotel"),), 25.0),
    "univ": Scene((("students03", "students003"), ("students01", "students001")), 25.0, 1),
    "zara1": Scene((("zara01",),), 25.0),
    "zara2": Scene((("zara02",),), 25.0),
}
"""By name. Rows are 0.4 s from each other: every 6th frame number in eth, every 10th in the others.
Social GAN's univ has students001 as well."""


def scene_of(recording: str) -> str | None:
    """Return the scene that a recording belongs to by its name; None where it is of none."""
    for name, scene in SCENES.items():
        if any(recording in names for names in scene.recordings):
            return name
    return None


@lru_cache(maxsize=16)
def read_scene_file(path: str, scene: str) -> Recording:
    """Read an ``obsmat.txt`` with its scene's frame rate."""
    return read_ucy(path, rate=SCENES[scene].rate)


def scene_files(data: str | Path, scene: str) -> tuple[Path, ...]:
    """Return the files of a scene below a folder: ``NAME_obsmat.txt`` or ``NAME/obsmat.txt``.

    Raises:
        RecordingError: a file is missing, or there are two of one recording.
    """
    rule = SCENES[scene]
    below = sorted(Path(data).rglob("*obsmat.txt")) if Path(data).is_dir() else []
    files: list[Path] = []
    for k, names in enumerate(rule.recordings):
        found = [path for path in below if _name(path) in names]
        if len(found) > 1:
            raise RecordingError(
                found[1], None, f"is a second recording {names[0]} next to {found[0]}; remove one"
            )
        if not found and k < len(rule.recordings) - rule.optional:
            raise RecordingError(
                data, None, f"has no {names[0]}_obsmat.txt in it or below; scene {scene} needs it"
            )
        files += found
    return tuple(files)


def _name(path: Path) -> str:
    """A recording's name, as `read_ucy` finds it."""
    return path.stem.removesuffix("obsmat").rstrip("_") or path.absolute().parent.name


def others(data: str | Path, held_out: str) -> tuple[Recording, ...]:
    """Return the recordings of all scenes but one.

    Raises:
        RecordingError: a file is missing.
    """
    return tuple(
        read_scene_file(str(path), scene)
        for scene in SCENES
        if scene != held_out
        for path in scene_files(data, scene)
    )
