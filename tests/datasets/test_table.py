"""Recordings from tables: data frames, mappings of columns, CSV files."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foresight_env.datasets import (
    Recording,
    RecordingError,
    open_recording,
    past_velocities,
    read_csv_table,
    write_ucy,
)

quick = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
LIBRARY = ("time", "agent", "x", "y", "kind", "heading")
USERS = dict(zip(LIBRARY, ("t [s]", "person", "pos,x", 'pos"y', "class", "psi"), strict=True))
RATE = 10.0


@st.composite
def tables(draw):
    """Rows of agents over frames with gaps, in any order, and the tracks that they make."""
    offset = draw(st.sampled_from([0.0, 12.0, -3.0, 1.7e9]))
    rows, tracks = [], {}
    for agent in draw(st.lists(st.sampled_from("abcdef"), min_size=1, max_size=4, unique=True)):
        frames = sorted(draw(st.sets(st.integers(0, 60), min_size=1, max_size=8)))
        kind = draw(st.sampled_from(["pedestrian", "bicycle", "car", "tram"]))
        number = st.floats(-1e3, 1e3).map(lambda v: round(v, 6))
        places = [(draw(number), draw(number)) for _ in frames]
        headings = [draw(st.sampled_from([0.0, 1.5, math.nan])) for _ in frames]
        jitter = [draw(st.sampled_from([-0.004, 0.0, 0.004])) for _ in frames]
        tracks[agent] = (kind, frames, places, headings)
        for frame, place, heading, late in zip(frames, places, headings, jitter, strict=True):
            rows.append((offset + frame / RATE + late, agent, *place, kind, heading))
    rows = draw(st.permutations(rows))
    return dict(zip(LIBRARY, map(list, zip(*rows, strict=True)), strict=True)), tracks


def check(recording, tracks):
    assert recording.source == "table"
    assert recording.rate == RATE
    assert set(recording.agents) == set(tracks)
    first = min(frames[0] for _, frames, _, _ in tracks.values())
    shift = recording.frame_range[0] - first
    for agent, (kind, frames, places, headings) in tracks.items():
        track = recording.track(agent)
        assert track.kind == kind
        np.testing.assert_array_equal(track.frames - shift, frames)
        np.testing.assert_array_equal(track.position, places)
        np.testing.assert_array_equal(track.heading, headings)
        np.testing.assert_allclose(track.velocity, past_velocities(track, track.frames, RATE))


@quick
@given(made=tables())
def test_a_table_is_a_recording(made):
    table, tracks = made
    recording = Recording.from_dataframe(table, rate=RATE)
    check(recording, tracks)
    assert recording.agents == tuple(dict.fromkeys(table["agent"]))


@quick
@given(made=tables(), delimiter=st.sampled_from([",", ";", "\t"]), bom=st.booleans())
def test_a_csv_file_is_the_same_recording(made, delimiter, bom, tmp_path_factory):
    table, tracks = made
    path = tmp_path_factory.mktemp("csv") / "mine.csv"
    with path.open("w", newline="", encoding="utf-8-sig" if bom else "utf-8") as stream:
        writer = csv.writer(stream, delimiter=delimiter)
        writer.writerow(["remark", *USERS.values()])
        for row in zip(*table.values(), strict=True):
            writer.writerow(["x", *("" if v != v else v for v in row)])
    recording = open_recording(path, columns=USERS, rate=RATE)
    check(recording, tracks)
    assert recording.name == "mine"


def test_a_pandas_frame():
    pandas = pytest.importorskip("pandas")
    table = {"t": [0.0, 0.1, 0.0], "id": [3, 3, 8], "x": [0.0, 0.1, 5.0], "y": [1.0, 1.0, 2.0]}
    columns = {"time": "t", "agent": "id"}
    frame = pandas.DataFrame(table, index=[7, 5, 9])
    found = Recording.from_dataframe(frame, columns=columns, rate=10, name="mine")
    assert found == Recording.from_dataframe(table, columns=columns, rate=10, name="mine")
    assert found.agents == ("3", "8")
    missing = pandas.DataFrame({**table, "id": [3, None, 8]})
    with pytest.raises(ValueError, match=r"row 1 \(from 0\): id is nan; expected a name"):
        Recording.from_dataframe(missing, columns=columns, rate=10)
    nullable = frame.astype({"id": "Int64", "x": "Float64"}).reset_index()
    nullable["heading"] = pandas.array([None, 0.5, 1.0], dtype="Float64")
    found = Recording.from_dataframe(nullable, columns=columns, rate=10)
    assert found.agents == ("3", "8")
    np.testing.assert_array_equal(found.track("3").heading, [math.nan, 0.5])


def test_frame_numbers():
    table = {"frame": [30, 10, 20], "agent": ["a"] * 3, "x": [3.0, 1.0, 2.0], "y": [0.0] * 3}
    found = Recording.from_dataframe(table, rate=25.0)
    np.testing.assert_array_equal(found.track("a").frames, [10, 20, 30])
    np.testing.assert_allclose(found.track("a").velocity, [[2.5, 0.0]] * 3)
    assert found.frame_step == 10


GOOD = {"time": [0.0, 0.1], "agent": ["a", "a"], "x": [0.0, 1.0], "y": [0.0, 0.0]}


@pytest.mark.parametrize(
    ("changes", "row", "told"),
    [
        ({"x": [0.0, math.nan]}, 1, "x is nan; expected a finite number"),
        ({"y": [math.inf, 0.0]}, 0, "y is inf; expected a finite number"),
        ({"x": ["0", "oops"]}, 1, "x is 'oops'; expected a finite number"),
        ({"agent": ["a", ""]}, 1, "agent is missing"),
        ({"agent": [0.0, 0.5]}, 1, "agent is 0.5; expected a name or a whole number"),
        ({"time": [0.0, 0.13]}, 1, "time is 0.13; expected 0.0 s and a whole number of 0.1 s"),
        ({"time": [0.0, 0.0]}, 1, "agent a has a second row for frame 0"),
        ({"kind": ["ped", "ped"]}, 0, "kind is 'ped'; expected 'pedestrian'"),
        ({"kind": ["car", "bicycle"]}, 1, "kind is 'bicycle', and 'car' in another row"),
        ({"heading": [0.0, math.inf]}, 1, "heading is inf; expected a finite number"),
        ({"x": [0.0]}, None, "columns differ in length: time 2, agent 2, x 1, y 2"),
        (dict.fromkeys(GOOD, ()), None, "the table has no rows"),
    ],
)
def test_a_value_that_cannot_be_used(changes, row, told):
    place = "" if row is None else f"row {row} (from 0): "
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        Recording.from_dataframe({**GOOD, **changes}, rate=10)
    assert str(caught.value).startswith(place + told)


@pytest.mark.parametrize(
    ("columns", "told"),
    [
        ({"tim": "time"}, "columns: 'tim' is unknown; choose from time, frame, agent"),
        ({"agent": "who"}, "columns: agent is 'who', which the table lacks; it has time, agent"),
        ({"time": "time", "frame": "time"}, "both time and frame are given"),
    ],
)
def test_columns_that_are_not_there(columns, told):
    with pytest.raises(ValueError, match=told):
        Recording.from_dataframe(GOOD, columns=columns, rate=10)
    without = {name: values for name, values in GOOD.items() if name not in ("time", "x")}
    with pytest.raises(ValueError, match="no column for time, x; the table has agent, y"):
        Recording.from_dataframe(without, rate=10)
    with pytest.raises(ValueError, match="rate must be positive and finite"):
        Recording.from_dataframe(GOOD, rate=0)


def test_a_frame_number_with_a_fraction():
    table = {**GOOD, "frame": [0, 1.5]}
    with pytest.raises(ValueError, match=r"row 1 .*frame is 1.5; expected a whole number"):
        Recording.from_dataframe(table, columns={"frame": "frame"}, rate=10)


TEXT = "time,agent,x,y\n0.0,a,0,0\n\n0.1,a,1,0\n"


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        (TEXT.replace("1,0", "one,0"), 4, "x is 'one'; expected a finite number"),
        (TEXT.replace("1,0\n", "1\n"), 4, "3 columns; there must be 4: time, agent, x, y"),
        (TEXT.replace("0.1,a", "0.1,"), 4, "agent is missing"),
        (TEXT.replace("0.1", "0.0"), 4, "second row for frame 0"),
        (TEXT.replace("agent", "who"), 1, "no column for agent; the table has time, who, x, y"),
        (TEXT.replace(",y", ",x,y", 1).replace(",0\n", ",0,0\n"), 1, "names x more than once"),
        ("time,agent,x,y\n", 1, "the table has no rows"),
        (TEXT.replace("1,0", '"1,0'), 4, "cannot be parsed"),
        ("", 1, "the file is empty"),
    ],
)
def test_a_csv_file_that_cannot_be_used(tmp_path, text, line, told):
    path = tmp_path / "mine.csv"
    path.write_text(text)
    with pytest.raises(RecordingError) as caught:
        read_csv_table(path, rate=10)
    assert told in caught.value.problem
    assert caught.value.line == line


def test_opening(tmp_path):
    path = tmp_path / "mine.csv"
    path.write_text(TEXT.rstrip("\n"))  # the last line may lack its end
    assert open_recording(path, rate=10).agents == ("a",)
    assert open_recording(path, format="table", rate=10).source == "table"
    for arguments, told in (
        ({}, "rate: is missing; mine.csv does not state"),
        ({"rate": math.nan}, "rate must be positive"),
        ({"rate": 10, "columns": {}, "format": "ucy"}, "columns: are those of a CSV file"),
    ):
        with pytest.raises(ValueError, match=told):
            open_recording(path, **arguments)
    with pytest.raises(RecordingError, match="columns belong to a CSV file"):
        open_recording(tmp_path, columns={}, rate=10)


def test_the_rate_of_other_formats(tmp_path: Path):
    table = {"frame": [0, 10], "agent": [1, 1], "x": [0.0, 1.0], "y": [0.0, 0.0]}
    path = write_ucy(Recording.from_dataframe(table, rate=25), tmp_path / "eth_obsmat.txt")
    assert open_recording(path).rate == 25.0
    assert open_recording(path, rate=15.0).rate == 15.0
    assert open_recording(tmp_path, rate=15.0).rate == 15.0
    clip = tmp_path / "clip_traj_ped_filtered.csv"
    clip.write_text("id,frame,label,x_est,y_est,vx_est,vy_est\n0,0,ped,0,0,0,0\n")
    with pytest.raises(ValueError, match="rate: is 10; leave it out, dut states that"):
        open_recording(clip, rate=10)


def test_rows_that_begin_at_other_frames():
    """As in ETH's first scene, where later people have other frame numbers, modulo the spacing."""
    frames = [0, 6, 12, 103, 109, 103, 109]
    agents = ["a", "a", "a", "b", "b", "c", "c"]
    table = {"frame": frames, "agent": agents, "x": np.arange(7.0), "y": np.zeros(7)}
    found = Recording.from_dataframe(table, rate=15)
    assert found.frame_step == 6
    assert found.window(("b", "c"), 103, 2).complete
    assert Recording.from_dataframe({k: v[:1] for k, v in table.items()}, rate=15).frame_step == 1
