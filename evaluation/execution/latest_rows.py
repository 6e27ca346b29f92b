"""Rows of agents as they are now, where a folder has some of earlier settings as well."""

from __future__ import annotations

from evaluation.execution.provenance import fingerprint
from evaluation.execution.store import Results, Row

MAKERS = ("ego", "predictor")
"""Columns that name an agent which the registry makes."""


def present(results: Results) -> tuple[Results, int]:
    """Results with one setting of each agent, and how many rows of others were left out.

    The one that the registry makes now, or the last that was stored where none is of that or where
    the agent, a user's, cannot be made here.
    """
    column = next((name for name in MAKERS if results.rows and name in results.rows[0]), None)
    if column is None or "settings" not in results.rows[0]:
        return results, 0
    stored: dict[str, list[str]] = {}
    for row in results.rows:
        stored.setdefault(row[column], []).append(row["settings"])
    chosen = {name: _chosen(column, name, settings) for name, settings in stored.items()}
    kept: list[Row] = [row for row in results.rows if row["settings"] == chosen[row[column]]]
    return results._replace(rows=kept), len(results.rows) - len(kept)


def _chosen(column: str, name: str, settings: list[str]) -> str:
    if len(set(settings)) == 1:
        return settings[0]
    from agents import make_ego, make_predictor

    try:
        now = fingerprint((make_ego if column == "ego" else make_predictor)(name))
    except (ValueError, ImportError):
        return settings[-1]
    return now if now in settings else settings[-1]
