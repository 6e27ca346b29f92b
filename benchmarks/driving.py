"""Egos that turn left, merge, change lanes and go round: safety, goals and time per decision."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from itertools import product

from agents.registry import DRIVING_EGOS
from benchmarks.report import Arguments, Result, TableRow
from benchmarks.timing import Yardstick
from evaluation.reports.driving import OTHERS
from evaluation.rollout.endings import COLLISION, OFF_ROAD, REACHED
from evaluation.studies.driving import DrivingConfiguration, paired, study, summarise
from foresight_env.highway.scenes import SCENES

BEHAVIOURS = ("receding", "idm")
SEEDS = 6
"""The paper has 50; `foresight evaluate driving --episodes 50` runs them."""


def rows_of(rows: Sequence[TableRow], scenes: Sequence[str]) -> Iterator[TableRow]:
    """A line per scene, kind of other drivers and ego."""
    for scene, others, ego in product(scenes, BEHAVIOURS, DRIVING_EGOS):
        found = summarise(rows, scene, others, ego)
        if found is None:
            continue
        yield {
            "scene": scene,
            "others": OTHERS[others],
            "ego": ego,
            "episodes": found.episodes,
            "collisions (at fault)": f"{found.ends[COLLISION]} ({found.faults})",
            "off road": found.ends[OFF_ROAD],
            "goal reached": found.ends[REACHED],
            "gap of boxes, mean (least) [m]": f"{found.gap.mean:.2f} ({found.least_gap:.2f})",
            "distance of middles, mean (least) [m]": (
                f"{found.distance.mean:.1f} ({found.least_distance:.1f})"
            ),
            "time to goal [s]": f"{found.time.mean:.2f}",
            "failed plans, fits": f"{found.failed_plans}, {found.failed_fits}",
            "decision p50, p99 [ms]": f"{found.latencies[0]:.0f}, {found.latencies[1]:.0f}",
        }


def differences(rows: Sequence[TableRow], scenes: Sequence[str]) -> Iterator[TableRow]:
    """The ego `infer-gamma` minus the other egos on the same seeds."""
    for scene, others, other in product(scenes, BEHAVIOURS, DRIVING_EGOS):
        found = (
            None if other == "infer-gamma" else paired(rows, scene, others, "infer-gamma", other)
        )
        if found is not None:
            yield {
                "scene": scene,
                "others": OTHERS[others],
                "minus": other,
                "collisions": f"{found.collisions:+d}",
                "gap of boxes [m]": "{:.2f} ({:.2f} to {:.2f})".format(*found.gap),
                "time to goal [s]": "{:.2f} ({:.2f} to {:.2f})".format(*found.time),
            }


def tables(rows: Sequence[TableRow], scenes: Sequence[str], note: str) -> list[Result]:
    """Both tables; `note`: the yardstick's."""
    note = (
        "4 cars, full states with noise std 0.1, seeds from 0 on, one per episode; discount "
        "factors of others uniform in (0.7, 1), the ego's 0.95. Time to goal: the time limit where "
        f"it was not reached. One process per core at work. {note}"
    )
    paired_note = "Means and 95 % bootstrap intervals over seeds; few seeds make them narrow."
    return [
        Result("Driving: egos among other cars", note, list(rows_of(rows, scenes))),
        Result("Driving: infer-gamma minus others", paired_note, list(differences(rows, scenes))),
    ]


def run(arguments: Arguments) -> list[Result]:
    """The study; `quick` has one seed of the left turn."""
    yardstick = Yardstick.measure()
    scenes = ("left_turn",) if arguments.quick else tuple(SCENES)
    with tempfile.TemporaryDirectory() as folder:
        rows = study(
            folder,
            scenes,
            BEHAVIOURS,
            tuple(DRIVING_EGOS),
            range(1 if arguments.quick else SEEDS),
            DrivingConfiguration(),
        )
    return [result.show(arguments.console) for result in tables(rows, scenes, yardstick.note)]
