"""A section of the report for every kind of study: its tables, its figures, its episodes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from shutil import copyfile

from rich.console import Console

from evaluation.execution.store import Results, Row
from evaluation.reports import eth_ucy
from evaluation.reports.benchmark import driven_parts, simulated_parts
from evaluation.reports.benchmark_page import print_parts
from evaluation.reports.driving import distances_over_time, place, print_driving
from evaluation.reports.figures import (
    HEATMAP_NAME,
    TRIAL_NAME,
    closed_loop_summary,
    error_against_noise,
)
from evaluation.reports.intersection import (
    SNAPSHOT,
    error_over_noise,
    print_errors,
    print_gammas,
)
from evaluation.reports.naming import OTHERS, label_of
from evaluation.reports.prediction import (
    curves,
    draw_reliability,
    error_over_time,
    print_prediction,
)
from evaluation.reports.safety import print_safety
from evaluation.reports.tables import print_closed_loop, print_estimation
from evaluation.reports.value import print_value, value_figure
from evaluation.rollout.clairvoyant import CLAIRVOYANT
from evaluation.rollout.endings import COLLISION, harmed
from evaluation.rollout.places import SETTINGS
from evaluation.rollout.setting import RunSetting
from evaluation.rollout.surprises import SURPRISES
from evaluation.studies.benchmark import BenchmarkConfiguration
from evaluation.studies.closed_loop import summarise
from evaluation.studies.driving import DrivingConfiguration
from evaluation.studies.safety import setting_under
from evaluation.studies.value import BASELINE
from evaluation.windows.table import with_windows

RELIABILITY = "Nominal probability of a forecast's regions, and the share of true positions in them"
"""Caption."""
Draw = Callable[[Path], Path]
"""Writes a figure to a path, in the format that its ending names."""


@dataclass(frozen=True)
class Watched:
    """An episode that can be watched again."""

    ego: str
    seed: int
    setting: RunSetting
    title: str
    why: str


@dataclass
class Section:
    """One study on the page."""

    title: str
    results: Results
    figures: dict[str, tuple[Draw, str]] = field(default_factory=dict)
    """By name: how it is drawn, and what it shows."""
    episodes: list[Watched] = field(default_factory=list)


@dataclass(frozen=True)
class _Plain:
    """A study with tables and one figure of all its rows."""

    title: str
    show: Callable[[Console, Sequence[Row]], None]
    name: str
    draw: Callable[[Sequence[Row], Path], Path]
    caption: str

    def section(self, results: Results, notes: Console) -> Section:
        self.show(notes, results.rows)
        figure = partial(self.draw, results.rows), self.caption
        return Section(self.title, results, {self.name: figure})


def _print_intersection(notes: Console, rows: Sequence[Row]) -> None:
    print_errors(notes, rows)
    print_gammas(notes, rows)


PLAIN = {
    "estimation": _Plain(
        "Crosswalk: how well foresight is inferred",
        print_estimation,
        "error_against_noise",
        error_against_noise,
        "Trajectory error over noise, infer-gamma and assume-gamma-1, with the Cramer-Rao bound",
    ),
    "intersection": _Plain(
        "Intersection: a recorded window",
        _print_intersection,
        "error_over_noise",
        error_over_noise,
        "Trajectory error over noise, infer-gamma, assume-gamma-1 and constant-velocity",
    ),
}
"""By the study's name."""


def section(results: Results, notes: Console) -> Section:
    """Print a study's tables on `notes` and say what else belongs to it."""
    if all(row["error"] for row in results.rows):
        notes.print("All trials failed.")
        return Section(results.study.capitalize(), results)
    makers = {
        "estimation": _estimation,
        "intersection": _intersection,
        "closed loop": _closed_loop,
        "driving": _driving,
        "value of information": _value,
        "safety": _safety,
        "prediction": _prediction,
        "eth-ucy": _eth_ucy,
        "benchmark, open loop": _open_benchmark,
        "benchmark, closed loop": _closed_benchmark,
    }
    return makers.get(results.study, _other)(results, notes)


def _names(rows: Sequence[Row], column: str) -> tuple[str, ...]:
    """In the order in which they first appear, those with a finished trial."""
    return tuple(dict.fromkeys(r[column] for r in rows if not r["error"]))


def _estimation(results: Results, notes: Console) -> Section:
    found = PLAIN["estimation"].section(results, notes)
    _add_picture(found, TRIAL_NAME, "One noisy sequence, and what both methods make of it")
    _add_picture(
        found, HEATMAP_NAME, "The objective over both discount factors, from noise-free data"
    )
    return found


def _intersection(results: Results, notes: Console) -> Section:
    found = PLAIN["intersection"].section(results, notes)
    _add_picture(
        found,
        SNAPSHOT,
        "Predictions from the first steps alone: dots observed, coloured lines predicted, broad "
        "lines ground truth",
    )
    return found


def _add_picture(found: Section, name: str, caption: str) -> None:
    """A picture that is stored with the rows, which do not hold what it shows."""
    kept = found.results.folder.parent / name

    def copied(path: Path) -> Path:
        return Path(copyfile(kept.with_suffix(path.suffix), path))

    if all(kept.with_suffix(f".{kind}").exists() for kind in ("png", "pdf")):
        found.figures[name] = copied, caption


def _closed_loop(results: Results, notes: Console) -> Section:
    rows = results.rows
    egos = _names(rows, "ego")
    print_closed_loop(notes, [summarise(rows, ego) for ego in egos], rows)
    found = Section("Crosswalk: an ego in the loop", results)
    found.figures["closed_loop"] = (
        lambda path: closed_loop_summary(rows, egos, path),
        "Distances, times and costs of every ego",
    )
    configuration = results.configuration
    setting = RunSetting(
        players=configuration["players"],
        observation=configuration["observation"],
        noise_std=configuration["noise_std"],
        behaviour=configuration["behaviour"],
        safety_filter=configuration.get("safety_filter", False),
    )
    chosen = _chosen(rows, lambda r: bool(r["collision"]))
    found.episodes += [Watched(r["ego"], r["seed"], setting, "Crosswalk", w) for r, w in chosen]
    return found


def _driving(results: Results, notes: Console) -> Section:
    rows = results.rows
    egos, scenes, others = (_names(rows, column) for column in ("ego", "scene", "others"))
    print_driving(notes, rows, scenes, others, egos)
    found = Section("Driving: an ego on highway-env's roads", results)
    configuration = results.configuration
    for scene in scenes:
        for other in others:

            def draw(path: Path, scene: str = scene, other: str = other) -> Path:
                return distances_over_time(rows, scene, other, egos, path)

            where = place(scene, other)
            found.figures[f"{scene}_{other}"] = (
                draw,
                f"{where}: distances to others and to the goal over time",
            )
            mine = [r for r in rows if (r["scene"], r["others"]) == (scene, other)]
            setting = DrivingConfiguration(**{"safety_filter": False, **configuration}).of(
                scene, other
            )
            title = where[0].upper() + where[1:]
            chosen = _chosen(mine, lambda r: r["ended"] == COLLISION, most=1)
            found.episodes += [Watched(r["ego"], r["seed"], setting, title, w) for r, w in chosen]
    return found


def _value(results: Results, notes: Console) -> Section:
    rows = results.rows
    settings, present = _names(rows, "setting"), _names(rows, "ego")
    bounds = (CLAIRVOYANT, "know-gamma", "oracle")
    bound = next((name for name in bounds if name in present), BASELINE)
    egos = tuple(ego for ego in present if ego != CLAIRVOYANT)
    print_value(notes, rows, settings, egos, bound)
    found = Section("Value of knowing the others' foresight", results)
    found.figures["value"] = (
        lambda path: value_figure(rows, settings, present, path),
        "Cost saved against the ego that assumes gamma = 1, and episodes with harm",
    )
    filtered = bool(results.configuration.get("safety_filter", False))
    for setting in settings:
        mine = [r for r in rows if r["setting"] == setting and r["ego"] != CLAIRVOYANT]
        title = setting.replace("_", " ")
        run = replace(SETTINGS[setting], safety_filter=filtered)
        found.episodes += [
            Watched(r["ego"], r["seed"], run, title, why)
            for r, why in _chosen(mine, harmed, most=2)
        ]
    return found


def _safety(results: Results, notes: Console) -> Section:
    rows = results.rows
    settings, egos = _names(rows, "setting"), _names(rows, "ego")
    surprises = tuple(name for name in SURPRISES if name in _names(rows, "surprise"))
    print_safety(notes, rows, settings, surprises, egos)
    found = Section("Safety: harm, and what avoiding it costs", results)
    filtered = bool(results.configuration.get("safety_filter", False))
    for setting in settings:
        for surprise in surprises:
            mine = [r for r in rows if (r["setting"], r["surprise"]) == (setting, surprise)]
            harm = [r for r in _chosen(mine, harmed, most=2) if harmed(r[0])]
            title = f"{setting.replace('_', ' ')}, {surprise}"
            run = setting_under(setting, surprise, filtered) if harm else None
            found.episodes += [
                Watched(r["ego"], r["seed"], run, title, why) for r, why in harm if run is not None
            ]
    return found


def _prediction(results: Results, notes: Console) -> Section:
    rows = with_windows(results.folder, results.rows)
    print_prediction(notes, rows)
    found = Section("Recordings: predictions", results)
    found.figures["error_over_time"] = (
        lambda path: error_over_time(rows, path),
        "Displacement errors 1 to 4 s ahead",
    )
    if curves(rows):
        found.figures["reliability"] = partial(draw_reliability, rows), RELIABILITY
    return found


def _eth_ucy(results: Results, notes: Console) -> Section:
    rows = results.rows
    eth_ucy.print_eth_ucy(notes, rows)
    found = Section("ETH/UCY: predictions, one scene left out", results)
    if eth_ucy.curves(rows):
        found.figures["reliability"] = partial(eth_ucy.draw_reliability, rows), RELIABILITY
    return found


def _open_benchmark(results: Results, notes: Console) -> Section:
    rows = results.rows
    configuration = BenchmarkConfiguration(
        _names(rows, "place"), (), _names(rows, "predictor"), (), 0
    )
    print_parts(notes, simulated_parts(rows, configuration), everything=True)
    return Section("Benchmark: predictors in simulated episodes", results)


def _closed_benchmark(results: Results, notes: Console) -> Section:
    rows = results.rows
    places, others = _names(rows, "place"), tuple(o for o in OTHERS if o in _names(rows, "others"))
    configuration = BenchmarkConfiguration(places, others, (), _names(rows, "ego"), 0)
    print_parts(notes, driven_parts(rows, configuration), everything=True)
    return Section("Benchmark: egos in simulated episodes", results)


def _other(results: Results, notes: Console) -> Section:
    columns = sorted({name for row in results.rows for name in row})
    notes.print(f"{len(results.rows)} rows with {', '.join(columns)}.", markup=False)
    return Section(results.study.capitalize(), results)


def _chosen(
    rows: Sequence[Row], harmed: Callable[[Row], bool], most: int = 3
) -> list[tuple[Row, str]]:
    """Episodes worth watching: the first seed with infer-gamma, and collisions."""
    whole = sorted((r for r in rows if not r["error"]), key=lambda r: (r["seed"], r["ego"]))
    first = [(r, "the first seed") for r in whole if r["ego"] == "infer-gamma"][:1]
    harm: dict[str, Row] = {}
    for row in whole:
        if harmed(row):
            harm.setdefault(row["ego"], row)
    return first + [(r, f"a collision of {label_of(r['ego'])}") for r in harm.values()][:most]
