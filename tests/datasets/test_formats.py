"""Every format: what is written is read again, and what is damaged is refused with its line."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foresight_env.datasets import (
    Recording,
    RecordingError,
    open_recording,
    read_dut,
    read_ind,
    read_ucy,
    recordings_below,
    write_dut,
    write_ind,
    write_ucy,
)
from tests.support.made_recordings import assert_close, random_recording, write

SOURCES = ("ind", "dut", "ucy")
quick = settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("source", SOURCES)
@quick
@given(seed=st.integers(0, 2**32 - 1), agents=st.integers(1, 6))
def test_written_is_read_again(source: str, seed: int, agents: int) -> None:
    recording = random_recording(source, seed, agents)
    with tempfile.TemporaryDirectory() as name:
        files = write(recording, Path(name))
        assert_close(open_recording(files[0]), recording)
        assert_close(open_recording(files[-1], format=source), recording)
        assert_close(open_recording(name), recording)
        assert not list(Path(name).glob("*.part"))


def _lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True)


def _fields(line: bytes, source: str) -> list[bytes]:
    return line.split() if source == "ucy" else line.rstrip(b"\n").split(b",")


def _line(fields: list[bytes]) -> bytes:
    return b",".join(fields) + b"\n"


# What a fault makes of the fields of a row; each leaves something that is no row.
FAULTS = {
    "missing field": lambda fields, k: fields[:k] + fields[k + 1 :],
    "additional field": lambda fields, k: [*fields[:k], b"1", *fields[k:]],
    "not a number": lambda fields, k: [*fields[:k], b"oops", *fields[k + 1 :]],
    "empty field": lambda fields, k: [*fields[:k], b"", *fields[k + 1 :]],
    "nan": lambda fields, k: [*fields[:k], b"nan", *fields[k + 1 :]],
    "infinite": lambda fields, k: [*fields[:k], b"-inf", *fields[k + 1 :]],
    "overflow": lambda fields, k: [*fields[:k], b"1e999", *fields[k + 1 :]],
    "fraction": lambda fields, k: [*fields[:k], b"1.5", *fields[k + 1 :]],
    "zero byte": lambda fields, k: [*fields[:k], b"1\x002", *fields[k + 1 :]],
    "not utf-8": lambda fields, k: [*fields[:k], b"\xff\xfe1", *fields[k + 1 :]],
    "wrong separator": lambda fields, k: [b";".join(fields)],
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("seed", [1, 2])
def test_damaged_row_is_refused_with_its_line(
    source: str, fault: str, seed: int, tmp_path: Path
) -> None:
    file = write(random_recording(source, seed), tmp_path)[0]
    lines = _lines(file)
    number = int(np.random.default_rng(seed).integers(source != "ucy", len(lines)))
    fields = FAULTS[fault](_fields(lines[number], source), 1)
    lines[number] = b"   ".join(fields) + b"\n" if source == "ucy" else _line(fields)
    file.write_bytes(b"".join(lines))
    with pytest.raises(RecordingError, match=r": .+; .+") as caught:
        open_recording(file)
    assert caught.value.file.name == file.name
    # Binary content near the start is reported for the file as a whole.
    assert caught.value.line in ((1, number + 1) if fault == "zero byte" else (number + 1,))


@pytest.mark.parametrize("source", SOURCES)
@settings(quick, max_examples=60)
@given(data=st.data())
def test_any_byte_level_damage_is_noticed_or_harmless(source: str, data: st.DataObject) -> None:
    """Cut, repeat, shuffle or blank parts: an error with a line, or the identical recording."""
    recording = random_recording(source, data.draw(st.integers(0, 99)))
    with tempfile.TemporaryDirectory() as name:
        files = write(recording, Path(name))
        file = data.draw(st.sampled_from(files))
        expected = open_recording(files[0])
        lines = _lines(file)
        first = 0 if source == "ucy" else 1
        # Cut inside a line: UCY and DUT do not say how many rows there are.
        kind = data.draw(st.sampled_from(["cut", "repeat", "shuffle", "blank", "crlf", "garbage"]))
        number = data.draw(st.integers(first, len(lines) - 1))
        if kind == "cut":
            kept = data.draw(st.integers(1, len(lines[number]) - 1))
            lines[number:] = [lines[number][:kept]]
        elif kind == "repeat":
            lines.insert(data.draw(st.integers(first, len(lines))), lines[number])
        elif kind == "shuffle":
            lines[first:] = data.draw(st.permutations(lines[first:]))
        elif kind == "blank":
            lines.insert(number, b"\n")
        elif kind == "crlf":
            lines = [line.replace(b"\n", b"\r\n") for line in lines]
        else:
            lines[number] = data.draw(st.binary(max_size=30)) + b"\x01\n" + lines[number]
        file.write_bytes(b"".join(lines))
        actual: Recording | RecordingError
        try:
            actual = open_recording(files[0])
        except RecordingError as error:
            actual = error
        if isinstance(actual, RecordingError):
            assert kind not in ("shuffle", "blank", "crlf")
            assert actual.line is not None
            assert actual.file.suffix == file.suffix
        else:
            assert kind not in ("cut", "garbage")
            assert actual == expected


@pytest.mark.parametrize("source", ["ind", "dut"])
def test_columns_may_be_reordered_and_others_added(source: str, tmp_path: Path) -> None:
    recording = random_recording(source, 3)
    for file in write(recording, tmp_path):
        lines = [_fields(line, source)[::-1] for line in _lines(file)]
        extra = [b"remark", *[b"x"] * (len(lines) - 1)]
        text = [_line([*line, word]) for line, word in zip(lines, extra, strict=True)]
        file.write_bytes(b"\xef\xbb\xbf" + b"".join(text))  # with a byte order mark
    assert_close(open_recording(tmp_path), recording)


@pytest.mark.parametrize("source", ["ind", "dut"])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_wrong_header_is_refused(source: str, number: int, tmp_path: Path) -> None:
    file = write(random_recording(source, 3), tmp_path)[0]
    lines = _lines(file)
    for name, problem in (
        (b"other", "header lacks"),
        (b"xCenter" if source == "ind" else b"x_est", "header"),
    ):
        fields = _fields(lines[0], source)
        fields[number] = name
        file.write_bytes(b"".join([_line(fields), *lines[1:]]))
        with pytest.raises(RecordingError, match=problem) as caught:
            open_recording(file)
        assert caught.value.line == 1


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("content", [b"", b"\n\n", b"PK\x03\x04rest", b"a\x00b\n", b"\x1f\x8bzip"])
def test_empty_and_binary_files_are_refused(source: str, content: bytes, tmp_path: Path) -> None:
    file = write(random_recording(source, 3), tmp_path)[0]
    file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"empty|binary") as caught:
        open_recording(file)
    assert caught.value.line == 1


@pytest.mark.parametrize("source", SOURCES)
def test_duplicate_row_names_the_later_line(source: str, tmp_path: Path) -> None:
    file = write(random_recording(source, 5), tmp_path)[0]
    lines = _lines(file)
    file.write_bytes(b"".join([*lines, lines[2]]))
    with pytest.raises(RecordingError, match="second row") as caught:
        open_recording(file)
    assert caught.value.line == len(lines) + 1


def test_lost_rows_and_tracks_of_ind_are_noticed(tmp_path: Path) -> None:
    tracks, meta, _ = write(random_recording("ind", 5), tmp_path)
    whole, whole_meta = _lines(tracks), _lines(meta)
    tracks.write_bytes(b"".join(whole[:-1]))
    with pytest.raises(RecordingError, match="cut off") as caught:
        read_ind(tmp_path, 7)
    assert (caught.value.file, caught.value.line) == (meta, len(whole_meta))
    tracks.write_bytes(b"".join(whole))
    meta.write_bytes(b"".join(whole_meta[:-1]))
    with pytest.raises(RecordingError, match="is not in") as caught:
        read_ind(tmp_path, 7)
    assert caught.value.file == tracks


def test_ind_recording_number(tmp_path: Path) -> None:
    recording = random_recording("ind", 1)
    write_ind(recording, tmp_path, 7)
    write_ind(recording, tmp_path, 12)
    assert read_ind(tmp_path, 7) == read_ind(tmp_path, "07") == read_ind(tmp_path, "7")
    assert open_recording(tmp_path, recording=12).name == "12"
    with pytest.raises(RecordingError, match=r"holds 07, 12"):
        open_recording(tmp_path)
    with pytest.raises(RecordingError, match="has no recording 8"):
        read_ind(tmp_path, 8)
    shutil.copy(tmp_path / "07_tracks.csv", tmp_path / "12_tracks.csv")
    with pytest.raises(RecordingError, match="recordingId is 7"):
        read_ind(tmp_path, 12)


def test_dut_pair_is_found_from_any_name(tmp_path: Path) -> None:
    recording = random_recording("dut", 2)
    pedestrians, vehicles = write_dut(recording, tmp_path / "clip")
    assert vehicles.name == "clip_traj_veh_filtered.csv"
    for path in (pedestrians, vehicles, tmp_path / "clip", tmp_path / "clip_traj", tmp_path):
        assert_close(open_recording(path), recording)
    vehicles.unlink()
    assert {track.kind for track in read_dut(pedestrians).tracks} == {"pedestrian"}
    with pytest.raises(RecordingError, match="neither"):
        read_dut(tmp_path / "other")


def test_dut_replaces_the_pair_as_a_whole(tmp_path: Path) -> None:
    recording = random_recording("dut", 2)
    write_dut(recording, tmp_path / "clip")
    walkers = recording.select(agents=[a for a in recording.agents if a.startswith("ped")])
    with pytest.raises(FileExistsError):
        write_dut(walkers, tmp_path / "clip")
    write_dut(walkers, tmp_path / "clip", overwrite=True)
    assert_close(read_dut(tmp_path / "clip"), walkers)


@pytest.mark.parametrize("source", SOURCES)
def test_nothing_is_overwritten_unasked(source: str, tmp_path: Path) -> None:
    recording = random_recording(source, 1)
    files = write(recording, tmp_path)
    before = [file.read_bytes() for file in files]
    with pytest.raises(FileExistsError, match="overwrite=True"):
        write(random_recording(source, 2), tmp_path)
    assert [file.read_bytes() for file in files] == before
    assert sorted(tmp_path.iterdir()) == sorted(files)


def test_ids_and_kinds_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    recordings = {source: random_recording(source, 1) for source in SOURCES}
    with pytest.raises(ValueError, match="whole numbers"):
        write_ind(recordings["dut"], tmp_path, 1)
    with pytest.raises(ValueError, match="resample"):
        write_dut(recordings["ind"], tmp_path / "clip")
    with pytest.raises(ValueError, match="pedestrians"):
        write_ucy(recordings["ind"], tmp_path / "obsmat.txt")
    empty = Recording(name="none", source="ucy", rate=25.0, tracks=())
    with pytest.raises(ValueError, match="without tracks"):
        write_ucy(empty, tmp_path / "obsmat.txt")
    assert not list(tmp_path.iterdir())


def test_ucy_rows_are_spaced_by_ten_frames(tmp_path: Path) -> None:
    recording = random_recording("ucy", 4)
    path = write_ucy(recording, tmp_path / "obsmat.txt")
    actual = read_ucy(path)
    assert actual.frame_step == 10
    assert actual.frame_step / actual.rate == pytest.approx(0.4)
    assert actual.name == tmp_path.name
    assert read_ucy(path, rate=15.0).rate == 15.0


def test_unknown_format_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("hello world\n", encoding="utf-8")
    with pytest.raises(RecordingError, match="not recognised"):
        open_recording(file)
    with pytest.raises(RecordingError, match="no such file"):
        open_recording(tmp_path / "absent.csv")
    with pytest.raises(RecordingError, match="holds no recording"):
        open_recording(tmp_path)


def test_recordings_are_found_in_folders(tmp_path: Path) -> None:
    """Every one once, in whatever folder, ready to be opened; a file is itself."""
    for source in SOURCES:
        (tmp_path / source).mkdir()
        write(random_recording(source, 1), tmp_path / source)
    (tmp_path / "ucy" / "deeper").mkdir()
    (file,) = write(random_recording("ucy", 2), tmp_path / "ucy" / "deeper")
    found = recordings_below(tmp_path)
    assert [(place.name, name) for place, name in found] == [
        ("dut", "clip"),
        ("ind", "07"),
        ("ucy", "zara"),
        ("deeper", "zara"),
    ]
    sources = [open_recording(place, recording=name).source for place, name in found]
    assert sources == ["dut", "ind", "ucy", "ucy"]
    assert recordings_below(file) == ((file, None),)
    (tmp_path / "nothing").mkdir()
    with pytest.raises(RecordingError, match="holds no recording"):
        recordings_below(tmp_path / "nothing")
