"""Leaderboard: ranks and intervals of all predictors and egos at all places, as Markdown.

From the tables that studies write, so that the page can be made again without running anything:
`benchmark.csv` of `foresight benchmark` and, where it is there, `eth_ucy.csv` of `foresight
evaluate eth-ucy`. `python -m evaluation.reports.leaderboard FOLDER PAGE` writes the page of the
documentation.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evaluation.reports.benchmark_results import (
    ADE,
    BEST,
    CLOSED,
    COLLISIONS_PREDICTED,
    COLLISIONS_TRUE,
    COST,
    COVERED_50,
    COVERED_90,
    FAILED,
    HARM,
    MISSED,
    NLL,
    OPEN,
    P50,
    P99,
    REACHED,
    TIME,
)
from foresight_env.files import write_atomically

HEAD = """# Leaderboard

{said}

Ranks are by {by}; in parentheses those that the
data leave possible at 95 % (Mogstad et al., 2024). Intervals are 95 % bootstrap intervals over
groups of dependent cases. Rows of one table have the same cases. Mean ranks are without the tables
of people and vehicles alone; predictors that do not enter all tables are at the end. **Bold**: may
be first."""
OWN = """## Your own row

A predictor is a class with a `name` and `predict(history, steps)`
([tutorial](tutorials/predictors.md)):

```sh
foresight benchmark --data DIR --predictors constant-velocity,hybrid-game,your_module:YourClass \\
    --egos constant-velocity,your_module:YourClass+plan --out results/mine
```

`results/mine/leaderboard.md` is this page with your rows. Settings are to be chosen on the
development recordings and on other seeds than the benchmark's (`foresight generate`). To have a row
here, open a pull request with the class, its `benchmark.csv` and the command that trains it.
"""


class Cell(NamedTuple):
    """A line of `benchmark.csv`."""

    mean: float
    low: float
    high: float
    rank: tuple[int, int, int] | None
    cases: int


Table = dict[str, dict[str, Cell]]
"""Cells by method and metric."""


def read_tables(path: Path) -> dict[tuple[str, str], Table]:
    """Return the cells of `benchmark.csv` by loop and place.

    Raises:
        ValueError: the file lacks a column.
    """
    found: dict[tuple[str, str], Table] = {}
    with path.open(newline="") as file:
        for number, row in enumerate(csv.DictReader(file), start=2):
            try:
                mean, low, high = (
                    float(row[name] or "nan") for name in ("mean", "low_95", "high_95")
                )
                ranked = [row[name] for name in ("rank", "rank_low_95", "rank_high_95")]
                first, least, most = (int(r) if r else 0 for r in ranked)
                cell = Cell(
                    mean, low, high, (first, least, most) if first else None, int(row["cases"])
                )
                place = found.setdefault((row["loop"], row["place"]), {})
                place.setdefault(row["method"], {})[row["metric"]] = cell
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{path}, line {number}: is not of a benchmark ({error})"
                ) from error
    return found


def write_leaderboard(folder: Path, page: Path) -> Path:
    """Write the page of the tables in a folder; return its path.

    Raises:
        ValueError: `benchmark.csv` is not one of a benchmark.
        OSError: it is missing.
    """
    tables = read_tables(folder / "benchmark.csv")
    places = {loop: [p for found, p in tables if found == loop] for loop in (OPEN, CLOSED)}
    parts: list[str] = []
    if places[OPEN]:
        found = {place: tables[OPEN, place] for place in places[OPEN]}
        by = (
            "mean displacement (ADE) and, in closed loop, by time to the goal (rows there by "
            "collisions first)"
        )
        whole = {place: table for place, table in found.items() if not _of_class(table)}
        parts += [HEAD.format(said=_conclusion(whole), by=by), "", *_overview(found, whole)]
        parts += [line for place in found for line in _open(place, found[place])]
    else:
        by = "time to the goal (rows by collisions first)"
        parts += [HEAD.format(said="Closed loop alone.", by=by), ""]
    scenes = folder / "eth_ucy.csv"
    if scenes.is_file():
        parts += _eth_ucy(scenes)
    parts += [line for place in places[CLOSED] for line in _closed(place, tables[CLOSED, place])]
    write_atomically(page, "\n".join([*parts, OWN]).encode())
    return page


def _conclusion(places: dict[str, Table]) -> str:
    """The first two methods by how often they may be first, in a sentence each."""
    whole = _ranked_everywhere(places)
    if not whole:
        return "Every method lacks a place."
    ranks = {m: [places[p][m][ADE.name].rank for p in places] for m in whole}
    known = {m: [r for r in found if r is not None] for m, found in ranks.items()}
    order = sorted(known, key=lambda m: float(np.mean([r[0] for r in known[m]])))
    return (
        "Of the predictors that enter every table "
        + "; ".join(
            f"`{m}` has rank {np.mean([r[0] for r in known[m]]):.1f} on average and may be first "
            f"in {sum(r[1] == 1 for r in known[m])} of {len(places)}"
            for m in order[:2]
        )
        + "."
    )


def _ranked_everywhere(places: dict[str, Table]) -> list[str]:
    sets = [{m for m, cells in table.items() if cells[ADE.name].rank} for table in places.values()]
    return sorted(set.intersection(*sets))


def _of_class(table: Table) -> bool:
    """Whether it is of agents of one class, with displacements alone."""
    return all(NLL.name not in cells for cells in table.values())


def _overview(places: dict[str, Table], whole: dict[str, Table]) -> Iterator[str]:
    """Errors and possible ranks: a row per method, a column per place.

    Mean ranks are of the places in `whole`.
    """
    methods = sorted({m for table in places.values() for m in table})

    def mean_rank(method: str) -> tuple[int, float]:
        ranks = [t[method][ADE.name].rank for t in whole.values() if method in t]
        known = [r[0] for r in ranks if r]
        return len(whole) - len(known), float(np.mean(known)) if known else math.inf

    yield "## Displacement (ADE, m) and rank"
    yield ""
    yield from _lines(
        ("predictor", "mean rank", *places),
        [
            (
                f"`{m}`",
                f"{mean_rank(m)[1]:.1f}" if math.isfinite(mean_rank(m)[1]) else "-",
                *(_with_rank(t[m][ADE.name]) if m in t else "-" for t in places.values()),
            )
            for m in sorted(methods, key=mean_rank)
        ],
    )


def _with_rank(cell: Cell) -> str:
    if cell.rank is None:
        return "-"
    place, low, high = cell.rank
    mean = f"**{cell.mean:.2f}**" if low == 1 else f"{cell.mean:.2f}"
    return f"{mean} {place} ({low}-{high})" if low != high else f"{mean} {place}"


def _open(place: str, table: Table) -> Iterator[str]:
    """All metrics of predictions at a place."""
    cases = max(cells[ADE.name].cases for cells in table.values())
    classes = _of_class(table)
    yield f"## {place}: {cases} {'agents' if classes else 'windows'}"
    yield ""
    head: tuple[str, ...] = ("predictor", "rank", "ADE, m", "interval")
    if not classes:
        head += (
            "missed, %", "best of 5, m", "NLL", "50 / 90 % regions", "collisions / true",
            "ms, p50 / p99", "fallback",
        )  # fmt: skip
    rows = []
    for method, cells in table.items():
        ade = cells[ADE.name]
        row = [f"`{method}`", _rank(ade), _number(ade.mean, 3), _interval(ade, 3)]
        if not classes:
            row += [
                _told(cells, MISSED.name, 0),
                _told(cells, BEST.name, 2),
                _told(cells, NLL.name, 2),
                _pair(cells, COVERED_50.name, COVERED_90.name, 0),
                _pair(cells, COLLISIONS_PREDICTED.name, COLLISIONS_TRUE.name, 0),
                _pair(cells, P50.name, P99.name, 1),
                _told(cells, FAILED.name, 0),
            ]
        rows.append(tuple(row))
    yield from _lines(head, rows)


def _closed(place: str, table: Table) -> Iterator[str]:
    """All metrics of egos at a place."""
    cases = max(cells[HARM.name].cases for cells in table.values())
    yield f"## Closed loop, {place}: {cases} episodes"
    yield ""
    head = ("ego", "collided, %", "goal, %", "time, s", "interval", "rank", "cost", "ms, p50 / p99")
    yield from _lines(
        head,
        [
            (
                f"`{method}`",
                _told(cells, HARM.name, 0),
                _told(cells, REACHED.name, 0),
                _told(cells, TIME.name, 2),
                _interval(cells[TIME.name], 2),
                _rank(cells[TIME.name]),
                _told(cells, COST.name, 2),
                _pair(cells, P50.name, P99.name, 0),
            )
            for method, cells in table.items()
        ],
    )


def _eth_ucy(path: Path) -> Iterator[str]:
    """Errors of the ETH/UCY protocol, with published ones."""
    yield "## ETH/UCY, one scene left out: ADE / FDE, m"
    yield ""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    counts = {int(r["agents"]) for r in rows if r["scene"] == "average" and r["agents"]}
    yield f"[Protocol](protocols.md#ethucy); measured on {max(counts, default=0)} agents."
    yield ""
    scenes = [s for s in dict.fromkeys(r["scene"] for r in rows) if s != "average"] + ["average"]
    made: dict[tuple[str, str], dict[str, dict[str, str]]] = {}
    for row in rows:
        source = row["source"].removeprefix("measured")
        made.setdefault((row["predictor"], source), {})[row["scene"]] = row
    lines: list[tuple[str, ...]] = []
    for (name, source), found in made.items():
        for prefix, futures in (("", "1"), ("best_", "20")):
            cells = tuple(_errors(found[s], prefix) if s in found else "-" for s in scenes)
            of_one = lines[-1][2:] if prefix and lines else ()
            if cells[-1] == "-" or cells == of_one:
                continue
            lines.append((f"{source}: {name}" if source else f"`{name}`", futures, *cells))
    yield from _lines(("predictor", "K", *scenes), lines)


def _errors(row: dict[str, str], prefix: str) -> str:
    pair = [row.get(f"{prefix}{name}") or "" for name in ("ade", "fde")]
    return " / ".join(f"{float(v):.2f}" for v in pair) if all(pair) else "-"


def _lines(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield "| " + " | ".join(head) + " |"
    yield "|---|" + "---:|" * (len(head) - 1)
    for row in rows:
        yield "| " + " | ".join(row) + " |"
    yield ""


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _interval(cell: Cell, digits: int) -> str:
    known = math.isfinite(cell.low) and math.isfinite(cell.high)
    return f"[{cell.low:.{digits}f}, {cell.high:.{digits}f}]" if known else "-"


def _rank(cell: Cell) -> str:
    if cell.rank is None:
        return "-"
    place, low, high = cell.rank
    told = f"{place} ({low}-{high})" if low != high else f"{place}"
    return f"**{told}**" if low == 1 else told


def _told(cells: dict[str, Cell], metric: str, digits: int) -> str:
    return _number(cells[metric].mean, digits) if metric in cells else "-"


def _pair(cells: dict[str, Cell], first: str, second: str, digits: int) -> str:
    told = [_told(cells, name, digits) for name in (first, second)]
    return "-" if told == ["-", "-"] else " / ".join(told)


if __name__ == "__main__":
    write_leaderboard(Path(sys.argv[1]), Path(sys.argv[2]))
