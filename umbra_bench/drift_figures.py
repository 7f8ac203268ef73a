"""The energy error over long runs, drawn from the tables alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from umbra_bench.plots import CLIP, PRECISIONS, log_scale, look_of, save, styled
from umbra_bench.results import load_table
from umbra_bench.schemas import DRIFT_SCHEMA, DRIFT_SERIES_SCHEMA
from umbra_bench.wording import method_title


def draw_drift(results: Path, output: Path) -> list[Path]:
    """Draw each scenario's long runs: does the energy error stay within bounds, and in which precision?

    Returns:
        `figures/SCENARIO-drift` without its endings, svg and png; none where no long run was made.
    """
    if not (results / "drift_series.parquet").is_file():
        return []
    series = load_table("drift_series", results, DRIFT_SERIES_SCHEMA)
    laws = load_table("drift", results, DRIFT_SCHEMA)
    written = []
    for scenario in series["scenario"].unique(maintain_order=True):
        figure = _draw(*(t.filter(pl.col("scenario") == scenario) for t in (series, laws)))
        written.append(save(figure, output / "figures" / f"{scenario}-drift"))
    return written


def _draw(series: pl.DataFrame, laws: pl.DataFrame) -> Figure:
    with styled():
        figure = Figure(figsize=(7.2, 3.9))
        FigureCanvasAgg(figure)
        handles: dict[str, Any] = {}
        panels = []
        for place, precision in enumerate(PRECISIONS):
            axes = figure.add_axes((0.09 + 0.335 * place, 0.14, 0.295, 0.76))
            panels.append(axes)
            log_scale(axes, "x")
            log_scale(axes, "y")
            for row in laws.filter(pl.col("precision") == precision).to_dicts():
                line = series.filter(
                    (pl.col("method") == row["method"])
                    & (pl.col("precision") == precision)
                    & (pl.col("dt") == row["dt"])
                )
                with np.errstate(invalid="ignore"):
                    size = np.maximum(
                        abs(line["lowest"].to_numpy()), abs(line["highest"].to_numpy())
                    )
                size = np.where(np.isfinite(size) & (size < CLIP) & (size > 0.0), size, np.nan)
                look = look_of(row["method"])
                (drawn,) = axes.plot(line["step"], size, color=look.colour, ls=look.line, lw=1.2)
                handles[method_title(row["method"])] = drawn
            axes.set_title(f"{precision}, dt = {series['dt'][0]:g} s", loc="left")
            axes.set_xlabel("steps")
            if not place:
                axes.set_ylabel("|energy error| / energy scale")
        low, high = zip(*(axes.get_ylim() for axes in panels), strict=True)
        for axes in panels:
            axes.set_ylim(min(low), max(high))
        figure.legend(
            handles.values(), handles.keys(), loc="center left", bbox_to_anchor=(0.755, 0.5)
        )
    return figure
