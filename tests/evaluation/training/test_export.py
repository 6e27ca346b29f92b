"""Exported tensors hold what was recorded, and the table the same."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from evaluation.training.export import export_recordings
from evaluation.windows.complete import OBSERVED, complete_agents
from foresight_env.datasets import RecordingError, write_dut
from foresight_env.datasets.dut import DUT_RATE
from tests.support.made_recordings import walk
from tests.support.made_scenes import crossing, write_scenes


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    data = write_scenes(tmp_path_factory.mktemp("scenes"))
    folder = tmp_path_factory.mktemp("out") / "tensors"
    return export_recordings(data, folder), folder


def test_arrays_are_what_was_recorded(exported):
    tensors, folder = exported
    with np.load(folder / "tensors.npz", allow_pickle=False) as found:
        for name, values in tensors._asdict().items():
            np.testing.assert_array_equal(found[name], values)
    assert tensors.history.shape[1:] == (8, 8, 2)
    assert tensors.future.shape[1:] == (8, 12, 2)
    np.testing.assert_allclose(tensors.dt, 0.4)
    for scene, name, rate in (("eth", "eth", 15.0), ("zara1", "zara01", 25.0)):
        recording = crossing(name, rate)
        rows = np.flatnonzero(tensors.scene == scene)
        assert sorted(set(tensors.frame[rows])) == list(complete_agents(recording))
        for s in rows:
            for a in np.flatnonzero(tensors.agents[s] != ""):
                track = recording.track(str(tensors.agents[s, a]))
                now = int(np.flatnonzero(track.frames == tensors.frame[s])[0])
                whole = np.concatenate([tensors.history[s, a], tensors.future[s, a]])
                mask = np.concatenate([tensors.history_mask[s, a], tensors.future_mask[s, a]])
                known = track.position[now - OBSERVED + 1 : now + 13]
                np.testing.assert_allclose(whole[mask], known)
                assert mask.sum() == len(known)
                assert mask.all() or not tensors.counted[s, a]
                assert tensors.kinds[s, a] == "pedestrian"
            empty = tensors.agents[s] == ""
            assert not tensors.history_mask[s, empty].any()
            assert not tensors.counted[s, empty].any()
    # Every agent counts once in each of the three windows of each scene.
    assert tensors.counted.sum() == 3 * 3 * 5


def test_the_table_holds_the_same_positions(exported):
    tensors, folder = exported
    table = pq.read_table(folder / "steps.parquet").to_pydict()
    s, a, k = (np.array(table[name]) for name in ("sample", "place", "step"))
    assert len(s) == tensors.history_mask.sum() + tensors.future_mask.sum()
    observed = k <= 0
    x = tensors.history[s[observed], a[observed], k[observed] + 7, 0]
    np.testing.assert_array_equal(np.array(table["x"])[observed], x)
    y = tensors.future[s[~observed], a[~observed], k[~observed] - 1, 1]
    np.testing.assert_array_equal(np.array(table["y"])[~observed], y)
    assert table["scene"] == tensors.scene[s].tolist()
    assert table["agent"] == tensors.agents[s, a].tolist()


def test_vehicles_and_people_of_another_format(tmp_path):
    """DUT has 23.98 frames per second: a step is ten of them."""
    frames = range(0, 230)
    from foresight_env.datasets import Recording

    made = Recording(
        "clip",
        "dut",
        DUT_RATE,
        (
            walk("ped:0", "pedestrian", frames, (0.0, 0.0), (1.0, 0.0), DUT_RATE),
            walk("veh:0", "car", frames, (0.0, 5.0), (2.0, 0.0), DUT_RATE, 0.0),
        ),
    )
    write_dut(made, tmp_path / "clip")
    tensors = export_recordings(tmp_path, tmp_path / "out")
    assert set(tensors.scene) == {"clip"}
    assert {k for row in tensors.kinds for k in row} == {"", "pedestrian", "car"}
    np.testing.assert_allclose(tensors.dt, 10.0 / DUT_RATE)
    assert len(tensors.frame) == 230 - 19 * 10


def test_nothing_to_export(tmp_path):
    with pytest.raises(RecordingError, match="holds no recording"):
        export_recordings(tmp_path, tmp_path / "out")
    write_scenes(tmp_path / "short", lambda name, rate: crossing(name, rate, rows=19))
    with pytest.raises(ValueError, match="no agent is present in 20 steps"):
        export_recordings(tmp_path / "short", tmp_path / "out")
    assert not (tmp_path / "out").exists()
