"""What a sweep shows: a curve for one number, a map for two, drawn from its table alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from umbra_bench.plots import log_scale, look_of, save, styled
from umbra_bench.results import check_seal
from umbra_bench.sweep.plan import Plan
from umbra_bench.wording import method_title

LEAST_ERROR = 1e-17
"""Drawn in place of no error at all, which has no logarithm."""


def draw_sweep(plan: Plan, table: Path, folder: Path) -> list[Path]:
    """Draw a sweep: the largest energy error against what varies, and where runs diverge.

    One varied number makes one figure of curves; two or more make a map for each method and
    precision, of the first two (of further ones the worst run counts).

    Returns:
        The figures written, without their endings, svg and png; none where no run has an energy error.
    """
    check_seal(table)
    rows = pl.read_parquet(table, glob=False)
    if rows["energy_error_max"].is_null().all():
        return []
    if len(plan.keys) == 1:
        return [save(_curves(plan, rows), folder / plan.name)]
    return [
        save(_map(plan, rows, *line), folder / f"{plan.name}-{line[0]}-{line[1]}")
        for line in plan.lines
    ]


def _curves(plan: Plan, rows: pl.DataFrame) -> Figure:
    key = plan.keys[0]
    with styled():
        figure = Figure(figsize=(7.2, 3.9))
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.105, 0.14, 0.6, 0.76))
        _scale(axes, "x", rows[key].to_numpy())
        log_scale(axes, "y")
        for method, precision in plan.lines:
            line = _of_line(rows, method, precision).sort(key)
            look = look_of(method)
            stable = line.filter(pl.col("diverged_at").is_null())
            axes.plot(
                stable[key],
                np.maximum(stable["energy_error_max"].to_numpy(), LEAST_ERROR),
                color=look.colour,
                linestyle=look.line if precision == "float64" else ":",
                marker=look.marker,
                markersize=3,
                lw=1.0,
                label=f"{method_title(method)}, {precision}",
            )
            if stable.height < line.height:
                first = line.filter(pl.col("diverged_at").is_not_null())[key][0]
                axes.axvline(first, color=look.colour, lw=0.8, ls=":", alpha=0.7)
        axes.set_xlabel(key, parse_math=False)
        axes.set_ylabel("largest energy error / energy scale")
        axes.set_title(f"{plan.name}: dotted, where runs begin to diverge", loc="left")
        figure.legend(loc="center left", bbox_to_anchor=(0.72, 0.5))
    return figure


def _map(plan: Plan, rows: pl.DataFrame, method: str, precision: str) -> Figure:
    x_key, y_key = plan.keys[-1], plan.keys[0]
    line = _of_line(rows, method, precision)
    errors = np.maximum(line["energy_error_max"].fill_null(np.nan).to_numpy(), LEAST_ERROR)
    diverged = line["diverged_at"].is_not_null().to_numpy()
    finite = errors[np.isfinite(errors) & ~diverged]
    low, high = (finite.min(), finite.max()) if finite.size else (LEAST_ERROR, 1.0)
    norm = LogNorm(low, max(high, 1.001 * low))
    with styled():
        figure = Figure(figsize=(7.2, 4.6))
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.115, 0.125, 0.7, 0.78))
        x, y = line[x_key].to_numpy(), line[y_key].to_numpy()
        _scale(axes, "x", x)
        _scale(axes, "y", y)
        if plan.file.vary[0].random or plan.file.vary[-1].random:
            drawn: Any = axes.scatter(
                x[~diverged], y[~diverged], c=errors[~diverged], norm=norm, s=8, cmap="viridis"
            )
            axes.scatter(x[diverged], y[diverged], marker="x", s=10, color="#b22222", lw=0.6)
        else:
            columns, rows_ = np.unique(x), np.unique(y)
            grid = np.full((len(rows_), len(columns)), -1.0)
            at = np.searchsorted(rows_, y), np.searchsorted(columns, x)
            np.maximum.at(grid, at, np.where(diverged | ~np.isfinite(errors), np.inf, errors))
            shown = np.ma.masked_where(~np.isfinite(grid), grid)
            axes.set_facecolor("#7d2230")
            axes.grid(False)
            drawn = axes.pcolormesh(
                columns, rows_, shown, norm=norm, shading="nearest", cmap="viridis"
            )
        axes.set_xlabel(x_key, parse_math=False)
        axes.set_ylabel(y_key, parse_math=False)
        share = diverged.mean()
        axes.set_title(
            f"{plan.name}: {method_title(method)}, {precision}; {100 * share:.3g} % diverged (red)",
            loc="left",
        )
        bar = figure.colorbar(drawn, cax=figure.add_axes((0.84, 0.125, 0.022, 0.78)))
        bar.set_label("largest energy error / energy scale")
    return figure


def _of_line(rows: pl.DataFrame, method: str, precision: str) -> pl.DataFrame:
    return rows.filter(
        (pl.col("method") == method)
        & (pl.col("precision") == precision)
        & pl.col("refused").is_null()
    )


def _scale(axes: Axes, which: Any, values: np.ndarray) -> None:
    """A log axis where the values are positive and span more than a factor of 30."""
    if values.min() > 0.0 and values.max() > 30.0 * values.min():
        log_scale(axes, which)
