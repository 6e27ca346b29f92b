"""Tables of the safety study (`evaluation.studies.safety`)."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evaluation.execution.store import Row
from evaluation.reports.failures import errors_of, failed
from evaluation.reports.naming import heading_of
from evaluation.reports.tables import mean_and_half
from evaluation.studies.safety import RECORDED, SafetySummary, possible, summarise


def print_safety(
    console: Console,
    rows: Sequence[Row],
    settings: Sequence[str],
    surprises: Sequence[str],
    egos: Sequence[str],
) -> None:
    """Collisions and goals, then what they cost: a line per setting and surprise."""
    harm, price = (
        Table(title="Harm: collisions (at fault), off the road; goals reached"),
        Table(title="Price: cost where unharmed, decisions that the filter replaced"),
    )
    for table in (harm, price):
        table.add_column("setting, surprise", no_wrap=True)
        for ego in egos:
            table.add_column(escape(heading_of(ego, console.width)), justify="right")
    for setting in settings:
        for surprise in surprises:
            if not possible(setting, surprise):
                continue
            found = [summarise(rows, setting, surprise, ego) for ego in egos]
            count = max((s.episodes for s in found if s is not None), default=0)
            name = setting if surprise == "none" else f"{setting}, {surprise}"
            harm.add_row(f"{name}, n {count}", *map(_harm, found))
            price.add_row(name, *map(_price, found))
    console.print(harm)
    console.print(price)
    if RECORDED in settings:
        console.print("recorded: agents follow their recorded tracks and ignore the ego.")
    console.print(
        "at fault: the ego moved, and the agent that it touched was ahead of its middle. The same "
        "seeds for all egos."
    )
    if errors := errors_of(rows):
        console.print(f"[red]{escape(failed(errors))}[/red]")


def _harm(found: SafetySummary | None) -> str:
    if found is None:
        return "-"
    off = f", {found.off_road} off" if found.off_road else ""
    return f"{found.collisions} ({found.at_fault}){off}; {found.reached}"


def _price(found: SafetySummary | None) -> str:
    if found is None:
        return "-"
    return f"{mean_and_half(found.cost, 1)}, {100.0 * found.interventions:.1f} %"
