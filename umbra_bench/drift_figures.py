"""The energy error over long runs, drawn from the tables alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from umbra_bench.errors import UmbraBenchError, one_line
from umbra_bench.plots import CLIP, PRECISIONS, log_scale, look_of, mark_beyond, save, styled
from umbra_bench.results import is_there, load_table
from umbra_bench.scenario_tables import in_order
from umbra_bench.schemas import DRIFT_LINE, DRIFT_SCHEMA, DRIFT_SERIES_SCHEMA
from umbra_bench.wording import method_title


class LongRuns(NamedTuple):
    """The long runs on one scenario: a row of `laws` each, and the samples of all."""

    scenario: str
    laws: pl.DataFrame
    series: pl.DataFrame


def load_long_runs(results: Path) -> list[LongRuns]:
    """What `umbra-bench drift` left, a bundle a scenario; none where no long run was made.

    Raises:
        UmbraBenchError: as :func:`umbra_bench.results.load_table`; a law without the samples of it.
    """
    if not is_there(results / "drift_series.parquet"):
        return []
    laws = load_table("drift", results, DRIFT_SCHEMA)
    series = load_table("drift_series", results, DRIFT_SERIES_SCHEMA)
    for row in laws.join(series, on=DRIFT_LINE, how="anti").select(DRIFT_LINE).to_dicts():
        line = "/".join(map(str, row.values()))
        raise UmbraBenchError(
            one_line(
                f"{results / 'drift.parquet'}: row {line}: has no samples in drift_series.parquet "
                "beside it; run `umbra-bench drift` again"
            )
        )
    return [
        LongRuns(name, *(table.filter(pl.col("scenario") == name) for table in (laws, series)))
        for name in laws["scenario"].unique(maintain_order=True)
    ]


def largest(series: pl.DataFrame) -> np.ndarray:
    """The largest size of the energy error since the sample before, in parts of the energy scale."""
    low, high = (series[name].to_numpy() for name in ("lowest", "highest"))
    return np.maximum(abs(low), abs(high))


def draw_drift(results: Path, output: Path) -> list[Path]:
    """Draw the long runs of each scenario.

    Returns:
        `figures/SCENARIO-drift` without its endings, svg and png; none where no long run was made.
    """
    return [
        save(draw_long_runs(runs), output / "figures" / f"{runs.scenario}-drift")
        for runs in load_long_runs(results)
    ]


def draw_long_runs(runs: LongRuns) -> Figure:
    """Does the energy error stay within bounds, and in which precision?"""
    laws, series = runs.laws, runs.series
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
            rows = {
                r["method"]: r for r in laws.filter(pl.col("precision") == precision).to_dicts()
            }
            for row in (rows[method] for method in in_order(rows)):
                line = series.filter(
                    (pl.col("method") == row["method"])
                    & (pl.col("precision") == precision)
                    & (pl.col("dt") == row["dt"])
                )
                size = largest(line)
                size = np.where(np.isfinite(size) & (size < CLIP) & (size > 0.0), size, np.nan)
                look = look_of(row["method"])
                (drawn,) = axes.plot(line["step"], size, color=look.colour, ls=look.line, lw=1.2)
                beyond = line.filter(pl.Series(~(largest(line) < CLIP)))
                if beyond.height:
                    mark_beyond(axes, beyond["step"][0], look.colour)
                handles[method_title(row["method"])] = drawn
            axes.set_title(f"{precision}, dt = {series['dt'][0]:g} s", loc="left")
            axes.set_xlabel("steps")
            axes.tick_params(labelleft=not place)
        panels[0].set_ylabel("|energy error| / energy scale")
        low, high = zip(*(axes.get_ylim() for axes in panels), strict=True)
        for axes in panels:
            axes.set_ylim(min(low), max(high))
        figure.legend(
            handles.values(), handles.keys(), loc="center left", bbox_to_anchor=(0.755, 0.5)
        )
    return figure
