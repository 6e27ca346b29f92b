"""Loading recordings of 100 MB in each format: time and memory, and Python's CSV reader's."""

from __future__ import annotations

import csv
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import ROOT, Yardstick, seconds_of
from foresight_env.datasets import (
    DUT_RATE,
    UCY_RATE,
    Recording,
    Track,
    open_recording,
    write_dut,
    write_ind,
    write_ucy,
)

MEGABYTES = 100
FRAMES = 1000
"""Rows of each track."""
FORMATS = {"ind": 25.0, "dut": DUT_RATE, "ucy": UCY_RATE}
"""Frames per second."""


def made(source: str, tracks: int) -> Recording:
    """People who walk at random, 1000 frames each, ten of them at a time."""
    random = np.random.default_rng(0)
    step = 10 if source == "ucy" else 1
    walkers = []
    for i in range(tracks):
        velocity = random.normal(size=(FRAMES, 2))
        walkers.append(
            Track(
                agent_id=f"ped:{i}" if source == "dut" else str(i),
                kind="pedestrian",
                frames=step * (np.arange(FRAMES) + i * FRAMES // 10),
                position=np.cumsum(velocity, axis=0) * step / FORMATS[source],
                velocity=velocity,
                heading=np.arctan2(velocity[:, 1], velocity[:, 0]),
            )
        )
    return Recording(name="00", source=source, rate=FORMATS[source], tracks=tuple(walkers))


def write(source: str, folder: Path, tracks: int) -> Path:
    """Write such a recording; the file that holds its rows."""
    recording = made(source, tracks)
    if source == "ind":
        return write_ind(recording, folder, 0, overwrite=True)[0]
    if source == "dut":
        return write_dut(recording, folder / "made", overwrite=True)[0]
    return write_ucy(recording, folder / "obsmat.txt", overwrite=True)


def row(source: str, megabytes: float) -> TableRow:
    """One line of the table."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        few = write(source, folder, 10).stat().st_size
        tracks = round(megabytes * 1e6 / few * 10)
        file = write(source, folder, tracks)
        yardstick = Yardstick.measure()
        run = subprocess.run(
            [sys.executable, "-m", "benchmarks.recordings", str(file)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
        )
        found = json.loads(run.stdout)
        size = file.stat().st_size
        plain = seconds_of(lambda: read_plainly(file))
    if found["rows"] != tracks * FRAMES:
        raise RuntimeError(f"{source}: {found['rows']} of {tracks * FRAMES} rows were read")
    return {
        "format": source,
        "file": f"{size / 1e6:.0f} MB",
        "rows": found["rows"],
        "loaded in": yardstick.formatted(found["seconds"]),
        "of the time of Python's csv and float": found["seconds"] / plain,
        "memory above that before": f"{found['bytes'] / 1e6:.0f} MB",
        "of the file": found["bytes"] / size,
    }


def read_plainly(file: Path) -> int:
    """All numbers of the file by `csv` and `float`: how many."""
    count = 0
    with file.open(newline="", encoding="utf-8") as stream:
        delimiter = "," if "," in stream.readline() else " "
        for fields in csv.reader(stream, delimiter=delimiter, skipinitialspace=True):
            for field in fields:
                try:
                    float(field)
                except ValueError:
                    continue
                count += 1
    return count


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` takes files of 10 MB."""
    megabytes = 10 if arguments.quick else MEGABYTES
    rows = [row(source, megabytes) for source in FORMATS]
    note = (
        f"Made recordings, {FRAMES} rows per person, read by `open_recording` into a `Recording`, "
        "once, in a separate process. Memory: the largest resident size less that before. Besides "
        "it a loop of Python's `csv.reader` and `float` over the same file, which keeps nothing."
    )
    return [Result("Loading large recordings", note, rows).show(arguments.console)]


def largest_bytes() -> int:
    """Largest resident size of this process so far.

    From Linux itself where possible: `getrusage` there counts the process that started this one.
    """
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def measure(path: str) -> dict[str, float]:
    """Load a recording in this process: seconds, bytes of memory, rows."""
    before = largest_bytes()
    begin = time.perf_counter()
    recording = open_recording(path)
    seconds = time.perf_counter() - begin
    rows = sum(track.frames.size for track in recording.tracks)
    return {"seconds": seconds, "bytes": largest_bytes() - before, "rows": rows}


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1])))
