"""Scenes of ETH/UCY are found by the names of common collections."""

import pytest

from evaluation.windows.eth_ucy import SCENES, read_scene_file, scene_files, scene_of
from foresight_env.datasets import RecordingError, write_ucy
from tests.support.made_scenes import crossing, write_scenes


def test_scenes_by_file_names(tmp_path):
    write_scenes(tmp_path)
    for scene in SCENES:
        (path,) = scene_files(tmp_path, scene)
        recording = read_scene_file(str(path), scene)
        assert scene_of(recording.name) == scene
        assert recording.frame_step / recording.rate == pytest.approx(0.4)
    write_ucy(crossing("students01"), tmp_path / "students01_obsmat.txt")
    assert len(scene_files(tmp_path, "univ")) == 2
    assert scene_of("intersection_01") is None


def test_scenes_by_folders(tmp_path):
    (tmp_path / "ETH" / "seq_eth").mkdir(parents=True)
    write_ucy(crossing("eth", 15.0), tmp_path / "ETH" / "seq_eth" / "obsmat.txt")
    (path,) = scene_files(tmp_path, "eth")
    assert read_scene_file(str(path), "eth").rate == 15.0


def test_what_is_missing_or_there_twice(tmp_path):
    with pytest.raises(RecordingError, match=r"has no zara01_obsmat.txt .*scene zara1 needs it"):
        scene_files(tmp_path, "zara1")
    write_scenes(tmp_path)
    (tmp_path / "zara01").mkdir()
    write_ucy(crossing("zara01"), tmp_path / "zara01" / "obsmat.txt")
    with pytest.raises(RecordingError, match="is a second recording zara01"):
        scene_files(tmp_path, "zara1")
