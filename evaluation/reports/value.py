"""Tables and figure of the value of information (`evaluation.studies.value`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.execution.store import Row
from evaluation.metrics.statistics import Interval, mean_interval
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.figures import save
from evaluation.reports.naming import colour_of, heading_of, label_of
from evaluation.rollout.clairvoyant import CLAIRVOYANT
from evaluation.rollout.endings import harmed, time_to_goal
from evaluation.studies.value import BASELINE
from evaluation.studies.value_summary import (
    Compared,
    Share,
    compare,
    episodes_of,
    share,
)


def print_value(
    console: Console,
    rows: Sequence[Row],
    settings: Sequence[str],
    egos: Sequence[str],
    bound: str = CLAIRVOYANT,
) -> None:
    """Value of information per setting, and the share of it that each ego closes."""
    compared = {setting: compare(rows, setting, bound) for setting in settings}
    table = Table(title=f"Value of information: what {BASELINE} loses to {bound} (95 %)")
    table.add_column("setting", no_wrap=True)
    table.add_column("value of information", no_wrap=True)
    others = [ego for ego in egos if ego not in (BASELINE, bound)]
    for ego in others:
        name = heading_of(ego, console.width)
        table.add_column(escape(f"share that\n{name}\ncloses"), justify="right")
    for setting, found in compared.items():
        if found is None:
            table.add_row(setting, "no episode finished", end_section=True)
            continue
        shares = [share(rows, setting, ego, bound) for ego in others]
        table.add_row(f"{setting}, n {found.seeds}")
        costs = (_cost_share(one, found.unharmed) for one in shares)
        table.add_row(f"  cost, n {found.unharmed}", _cost(found), *costs)
        table.add_row("  harmed", _harm(found), *map(_harm_share, shares))
        table.add_row("  time to goal, s", _interval(found.time), end_section=True)
    console.print(table)
    _print_episodes(console, rows, settings, (*egos, *([] if bound in egos else [bound])))
    console.print(
        f"cost: where neither of the compared egos is harmed, also in % of {BASELINE}'s. harmed: "
        f"collided or left the road, {BASELINE} -> {bound}; p: McNemar's exact test. A share is "
        "given where the gap is significant (the clairvoyant's is never negative, by construction)."
    )
    if errors := errors_of(rows):
        console.print(f"[red]{escape(failed(errors))}[/red]")


def _interval(found: Interval, digits: int = 2) -> str:
    return f"{found.mean:.{digits}f} [{found.low:.{digits}f}, {found.high:.{digits}f}]"


def _cost(found: Compared) -> str:
    if found.cost is None:
        return "one of the two is always harmed"
    return f"{_interval(found.cost)}, {100.0 * found.relative_cost:.0f} %"


def _harm(found: Compared) -> str:
    first, second = found.harmed
    return f"{first} -> {second}, p {found.p_value:.2g}"


def _cost_share(found: Share, unharmed: int) -> str:
    """The share, and its number of seeds where that is not the gap's."""
    if found.cost is None:
        return "-"
    mean, low, high = (100.0 * value for value in found.cost)
    seeds = "" if found.unharmed == unharmed else f", n {found.unharmed}"
    return f"{mean:.0f} % [{low:.0f}, {high:.0f}]{seeds}"


def _harm_share(found: Share) -> str:
    return "-" if found.harm is None else f"{100.0 * found.harm:.0f} %"


def _print_episodes(
    console: Console, rows: Sequence[Row], settings: Sequence[str], egos: Sequence[str]
) -> None:
    """How each ego's episodes went: harm, smallest gap, cost where unharmed, time to the goal."""
    table = Table(title="Episodes (means ±95 %)")
    table.add_column("setting", no_wrap=True)
    for ego in egos:
        table.add_column(escape(heading_of(ego, console.width)), justify="right")
    for setting in settings:
        own = [list(episodes_of(rows, setting, ego).values()) for ego in egos]
        if not any(own):
            continue
        table.add_row(setting)
        table.add_row("  harmed", *map(_harmed_of, own))
        costs = [[r["cost"] for r in good if not harmed(r)] for good in own]
        table.add_row("  cost, unharmed", *map(_mean, costs))
        times = [[time_to_goal(r) for r in good] for good in own]
        table.add_row("  time to goal, s", *map(_mean, times), end_section=True)
    console.print(table)


def _harmed_of(episodes: Sequence[Row]) -> str:
    return f"{sum(map(harmed, episodes))} of {len(episodes)}" if episodes else "-"


def _mean(values: Sequence[float]) -> str:
    if not values:
        return "-"
    found = mean_interval(np.array(values))
    half = max(found.high - found.mean, found.mean - found.low)
    return f"{found.mean:.2f} ±{half:.2f}"


def value_figure(
    rows: Sequence[Row], settings: Sequence[str], egos: Sequence[str], path: Path
) -> Path:
    """Per setting, what each ego saves in cost against the baseline, and how often it is harmed."""
    figure = Figure(figsize=(9.0, 1.6 + 0.8 * len(settings)), layout="constrained")
    saved, harm = figure.subplots(1, 2, sharey=True)
    shown = [ego for ego in egos if ego != BASELINE]
    height = 0.8 / (len(shown) + 1)
    for k, setting in enumerate(settings):
        for n, ego in enumerate((BASELINE, *shown)):
            place = -k + 0.4 - (n + 0.5) * height
            good = list(episodes_of(rows, setting, ego).values())
            if not good:
                continue
            colour = colour_of(ego)
            share_harmed = 100.0 * sum(map(harmed, good)) / len(good)
            harm.barh(place, share_harmed, 0.9 * height, color=colour)
            found = compare(rows, setting, ego)
            if ego == BASELINE or found is None or found.cost is None or not found.cost.mean:
                continue
            percent = 100.0 * found.relative_cost / found.cost.mean
            middle, low, high = (percent * value for value in found.cost)
            saved.errorbar(
                middle, place, xerr=[[middle - low], [high - middle]],
                fmt="o", ms=4, capsize=3, color=colour,
            )  # fmt: skip
    saved.axvline(0.0, color=colour_of(BASELINE), lw=1.5)
    saved.set_yticks([-k for k in range(len(settings))], settings)
    saved.set_xlabel(f"cost saved against {BASELINE} [%], 95 %,\nwhere neither is harmed")
    harm.set_xlabel("episodes with a collision or off the road [%]")
    if not any(bar.get_width() for bar in harm.patches):
        harm.text(0.5, 0.5, "none", transform=harm.transAxes, ha="center", va="center")
    harm.set_xlim(0.0, max(10.0, harm.get_xlim()[1]))
    names = [Patch(color=colour_of(ego), label=label_of(ego)) for ego in (BASELINE, *shown)]
    figure.legend(handles=names, fontsize=8, loc="outside upper center", ncols=len(names))
    return save(figure, path)
