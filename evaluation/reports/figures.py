"""Figures, drawn without a display and written atomically. Colours: Okabe and Ito (2008)."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text

from evaluation.execution.store import Row
from evaluation.reports.naming import colour_of, label_of
from evaluation.studies.estimation import LEAST_STD, bound, truth
from evaluation.studies.heatmap import Heatmap
from evaluation.windows.encounters import Encounter, Judged
from foresight_env.envs.rendering.style import COLOURS as AGENT_COLOURS
from foresight_env.envs.rendering.style import INTERVAL_DEVIATIONS
from foresight_env.files import write_atomically
from foresight_env.inverse import Estimate
from foresight_env.scenarios.crosswalk import MONTE_CARLO

AGENTS = tuple("#{:02X}{:02X}{:02X}".format(*colour) for colour in AGENT_COLOURS)
"""As in the pictures of the environment."""
LEAST_SPAN = 4.0
"""Least width and height of an encounter's picture, m: a narrower one is not legible."""


PAPER_WIDTH = 7.16
"""Inches across both columns of a paper in IEEE's format."""


HEATMAP_NAME = "heatmap"
TRIAL_NAME = "representative_trial"
"""Names of pictures that are written next to a study's rows, which do not hold what they show."""


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG at 150 dots per inch or, where the path ends so, a PDF for a paper."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    if path.suffix == ".pdf":
        _shrink(figure, PAPER_WIDTH / figure.get_figwidth())
        figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    else:
        figure.savefig(buffer, format="png", dpi=150)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())
    return path


def _shrink(figure: Figure, factor: float) -> None:
    """Another size of the same picture: letters and lines along with the whole."""
    figure.set_size_inches(*(factor * figure.get_size_inches()))
    for text in figure.findobj(Text):
        text.set_fontsize(factor * float(text.get_fontsize()))
    for line in figure.findobj(Line2D):
        line.set_linewidth(factor * float(line.get_linewidth()))
        line.set_markersize(factor * float(line.get_markersize()))


def _metres(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _at_least(axes: Axes, span: float) -> None:
    """Widen the axes about their middle until each shows `span`."""
    for limits, widen in ((axes.get_xlim(), axes.set_xlim), (axes.get_ylim(), axes.set_ylim)):
        lacking = max(0.0, span - (limits[1] - limits[0]))
        widen(limits[0] - 0.5 * lacking, limits[1] + 0.5 * lacking)


def _name(axes: Axes, name: str, place: Any) -> None:
    """An agent's name that stays legible on top of lines."""
    axes.annotate(
        name, tuple(place), xytext=(7, 7), textcoords="offset points", fontsize=9, zorder=5,
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.8, "lw": 0},
    )  # fmt: skip


def representative_trial(
    seen: Float[np.ndarray, "stages size"], fits: Mapping[str, Estimate], path: Path
) -> Path:
    """One noisy sequence, what both methods make of it, and the inferred discount factors."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    parts: Any = figure.subfigures(1, 2, width_ratios=(1.4, 1.0))
    scene, bars = (part.subplots() for part in parts)
    half = seen.shape[1] // 2
    for i in range(2):
        places = seen[:, i * half : i * half + 2]
        scene.plot(*places.T, ".", color="0.6", ms=5, label="observations" if i == 0 else None)
        true = truth("soft").states[i]
        scene.plot(
            *true[:, :2].T, color="black", lw=3, alpha=0.35, label="truth" if i == 0 else None
        )
        scene.plot(*true[0, :2], "o", color="black", ms=8)
        _name(scene, f"agent {i}", true[0, :2])
        goal = MONTE_CARLO.goals[i]
        scene.plot(*goal, "X", color="black", ms=10, label="true goal" if i == 0 else None)
    for name, found in fits.items():
        for i in range(2):
            label = label_of(name) if i == 0 else None
            scene.plot(
                *found.solution.states[i][:, :2].T, color=colour_of(name), lw=1.6, label=label
            )
            goal = found.theta[i]["goal"]
            scene.plot(*np.clip(goal, -1.0, 3.0), "x", color=colour_of(name), ms=8, mew=2)
    _metres(scene)
    scene.set_title("what noisy observations imply (x: inferred goals)", fontsize=10)
    scene.margins(0.3, 0.2)
    found = fits["infer-gamma"]
    for i in range(2):
        bars.bar(
            i - 0.2, MONTE_CARLO.gamma[i], 0.38, color="0.75", label="truth" if i == 0 else None
        )
        bars.bar(
            i + 0.2,
            found.gamma[i],
            0.38,
            yerr=np.abs(found.gamma_interval[i] - found.gamma[i])[:, None],
            capsize=4,
            color=colour_of("infer-gamma"),
            label="inferred, 90 % interval" if i == 0 else None,
        )
    bars.axhline(1.0, color=colour_of("assume-gamma-1"), ls="--", label=label_of("assume-gamma-1"))
    bars.set_xticks([0, 1], ["agent 0", "agent 1"])
    bars.set_title("inferred discount factors", fontsize=10)
    bars.set_ylim(0.0, 1.1)
    bars.set_ylabel("discount factor gamma")
    for part, columns in zip(parts, (3, 2), strict=True):
        part.legend(fontsize=8, loc="outside lower center", ncols=columns)
    return save(figure, path)


def error_against_noise(rows: Sequence[Row], path: Path) -> Path:
    """Mean trajectory error of both methods over noise, with the Cramer-Rao bound."""
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    observations = [o for o in ("full", "positions") if any(r["observation"] == o for r in rows)]
    panels = np.atleast_1d(figure.subplots(1, len(observations), sharey=True))
    for axes, observation in zip(panels, observations, strict=True):
        for method in ("infer-gamma", "assume-gamma-1"):
            mine = [r for r in rows if r["observation"] == observation and r["method"] == method]
            stds = sorted({r["std"] for r in mine})
            grouped = [
                np.array([r["error_squared"] for r in mine if r["std"] == s and not r["error"]])
                for s in stds
            ]
            mean = np.array([g.mean() for g in grouped])
            low = np.array([np.percentile(g, 10) for g in grouped])
            high = np.array([np.percentile(g, 90) for g in grouped])
            # Noise-free fits have errors of 1e-18, which would flatten everything else: they are a
            # mark at the lower edge, not part of the line.
            floor = 1e-5
            noisy = np.array(stds) > 0.0
            axes.plot(
                np.array(stds)[noisy], mean[noisy], ".-",
                color=colour_of(method), label=label_of(method),
            )  # fmt: skip
            axes.plot(np.array(stds)[~noisy], np.maximum(mean[~noisy], floor), "v",
                      color=colour_of(method), clip_on=False)  # fmt: skip
            axes.fill_between(
                np.array(stds)[noisy], low[noisy], high[noisy],
                color=colour_of(method), alpha=0.2, lw=0,
            )  # fmt: skip
        grid = np.linspace(LEAST_STD, max(r["std"] for r in rows), 100)
        limit = bound(observation) * grid**2
        axes.plot(grid, limit, "k--", lw=1.2, label="Cramer-Rao bound")
        axes.set_yscale("log")
        axes.set_xlabel("noise standard deviation [m, m/s]")
        axes.set_title("full state" if observation == "full" else "positions only")
    panels[0].set_ylabel("trajectory error ||X - X_true||^2")
    panels[0].legend(fontsize=8)
    figure.suptitle(
        "mean and 10-90 % band; triangles: noise-free, at 1e-5 or above; the bound is local: "
        "limits on velocities keep large errors below it",
        fontsize=9,
    )
    return save(figure, path)


def objective_heatmap(grid: Heatmap, path: Path) -> Path:
    """The objective scaled to [0, 1]."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for axes, values, title in zip(
        panels, (grid.full, grid.positions), ("full state", "positions only"), strict=True
    ):
        low, high = np.nanmin(values), np.nanmax(values)
        image = axes.pcolormesh(
            grid.gammas, grid.gammas, (values - low) / (high - low), cmap="viridis", vmin=0, vmax=1
        )
        axes.plot(0.6, 0.6, "r+", ms=12, mew=2, label="truth")
        axes.set_xlabel("gamma of agent 1")
        axes.set_title(title)
        axes.set_aspect("equal")
    panels[0].set_ylabel("gamma of agent 0")
    panels[0].legend(fontsize=8)
    figure.colorbar(image, ax=panels, label="objective, scaled to [0, 1]")
    return save(figure, path)


def closed_loop_summary(rows: Sequence[Row], egos: Sequence[str], path: Path) -> Path:
    """Per ego: every episode's smallest distance, time and cost."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    columns = {
        "min_distance": "smallest distance between discs [m]",
        "time": "duration of the episode [s]",
        "cost": "cost of the ego",
    }
    for axes, (column, label) in zip(figure.subplots(1, 3), columns.items(), strict=True):
        for k, ego in enumerate(egos):
            values = np.array([r[column] for r in rows if r["ego"] == ego and not r["error"]])
            # A fixed spread separates equal values without hiding any.
            place = k + 0.25 * np.sin(2.4 * np.arange(len(values)))
            axes.plot(place, values, ".", color=colour_of(ego), alpha=0.6, ms=5)
            axes.plot([k - 0.3, k + 0.3], [values.mean()] * 2, color="black", lw=2)
        axes.set_xticks(
            range(len(egos)), [label_of(e).replace("-", "-\n", 1) for e in egos], fontsize=8
        )
        axes.set_title(label, fontsize=9)
    figure.suptitle("episodes (dots) and means (bars)", fontsize=9)
    return save(figure, path)


def gamma_over_time(
    times: Sequence[float],
    gammas: Sequence[Mapping[int, tuple[float, float]]],
    true: Float[np.ndarray, "N"],
    path: Path,
) -> Path:
    """Inferred discount factors of one episode with 90 % intervals.

    `true` is NaN where there is none.
    """
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    axes = figure.subplots()
    for j in sorted({j for g in gammas for j in g}):
        known = [(t, *g[j]) for t, g in zip(times, gammas, strict=True) if j in g]
        t, mean, deviation = np.array(known).T
        axes.plot(t, mean, color=AGENTS[j], label=f"agent {j}, inferred")
        half = INTERVAL_DEVIATIONS * deviation
        axes.fill_between(
            t, np.maximum(mean - half, 0.0), np.minimum(mean + half, 1.0), color=AGENTS[j],
            alpha=0.2, lw=0,
            label=f"agent {j}, 90 % interval",
        )  # fmt: skip
        if not np.isnan(true[j]):
            axes.axhline(true[j], color=AGENTS[j], ls="--", label=f"agent {j}, true")
    axes.set_ylim(0.0, 1.05)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("discount factor gamma")
    figure.legend(fontsize=8, loc="outside right upper")
    return save(figure, path)


def recorded_encounter(encounter: Encounter, forecasts: Sequence[Judged], path: Path) -> Path:
    """Observations, ground truth, and each method's prediction."""
    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    axes = figure.subplots()
    window = encounter.window
    for a, name in enumerate(window.agents):
        seen = window.history.states[:, a, :2]
        axes.plot(*seen.T, ".", color="0.5", label="observed" if a == 0 else None)
        axes.plot(
            *np.concatenate([seen[-1:], window.truth[:, a]]).T, "-", color="black", lw=4, alpha=0.3,
            label="ground truth" if a == 0 else None,
        )  # fmt: skip
        _name(axes, name, seen[~np.isnan(seen[:, 0])][0])
    for found in forecasts:
        label = label_of(found.predictor)
        with_errors = f"{label} (ADE {found.average_error:.2f} m, FDE {found.final_error:.2f} m)"
        path_to = found.forecast.most_likely
        for a in range(len(window.agents)):
            start = window.history.states[-1, a, :2][None]
            compared = window.present[:, a, None]
            line: Any = np.concatenate([start, np.where(compared, path_to[:, a], np.nan)])
            axes.plot(
                # Wider, since the others often lie on top of it.
                *line.T, ".-", ms=3, lw=3.0 if found.predictor == "encounter-game" else 1.2,
                color=colour_of(found.predictor),
                label=with_errors if a == 0 else None,
            )  # fmt: skip
    _metres(axes)
    axes.margins(0.1)  # room for names
    _at_least(axes, LEAST_SPAN)
    axes.set_title(f"{window.recording}: {window.agents[0]} and {window.agents[1]}")
    figure.legend(fontsize=8, loc="outside lower center", ncols=2)
    return save(figure, path)
