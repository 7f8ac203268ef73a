"""The figures of the claims page, drawn from the curves on disk alone; each answers one question."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from umbra_bench.plots import Look, log_scale, look_of, power_of_ten, slope_guides, styled
from umbra_bench.wording import method_title

_HALVES = {
    "umbra-primed": Look("#777777", "-", "^"),
    "umbra-swapped": Look("#E69F00", (0, (4, 1.5)), "p"),
}
"""The looks of the halves of the repair, which no other figure shows."""


_COLOURS = ("#440154", "#3b528b", "#21918c", "#5ec962", "#d4b400")
_LINES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (4, 1.5, 1, 1.5)))
_SCENARIOS = [(colour, line) for line in _LINES for colour in _COLOURS]
"""The looks of scenarios: the colours of methods would say that a method was drawn."""


def _series(curves: pl.DataFrame, proof: str) -> Iterator[tuple[str, pl.DataFrame]]:
    table = curves.filter(pl.col("proof") == proof)
    for name in table["series"].unique(maintain_order=True):
        yield name, table.filter(pl.col("series") == name)


def _one_panel(x_label: str, y_label: str) -> tuple[Figure, Axes]:
    """One panel with room for a legend on the right."""
    figure = Figure(figsize=(7.2, 3.9))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.1, 0.13, 0.56, 0.82))
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    return figure, axes


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="center left", bbox_to_anchor=(0.68, 0.53))


def draw_stability(curves: pl.DataFrame) -> Figure:
    """Up to which omega dt does a method not grow?"""
    with styled():
        figure, axes = _one_panel("ω dt", "growth per step")
        for i, (name, table) in enumerate(_series(curves, "stability")):
            method, _, damped = name.partition(", ")
            label = method_title(method) + (f", {damped}" if damped else "")
            look = look_of(method)
            axes.plot(table["x"], table["predicted"], color="#cfcfcf", lw=4, zorder=1)
            axes.plot(
                table["x"],
                table["measured"],
                color=look.colour,
                linestyle=(0, (1, 1.2)) if damped else look.line,
                marker=look.marker,
                markevery=(i, 9),
                label=label,
            )
        axes.plot([], [], color="#cfcfcf", lw=4, label="theory")
        axes.axhline(1.0, color="#777777", lw=0.7)
        axes.set_xlim(0.0, 3.5)
        axes.set_ylim(0.4, 3.0)
        _legend(figure, axes)
    return figure


def draw_backward_error(curves: pl.DataFrame) -> Figure:
    """Does the energy error follow the prediction?"""
    with styled():
        found = list(_series(curves, "backward-error"))
        figure = Figure(figsize=(9.2, 4.4))
        FigureCanvasAgg(figure)
        panels = figure.subplots(2, math.ceil(len(found) / 2), sharex=True).ravel()
        for axes, (method, table) in zip(panels, found, strict=False):
            size = float(np.abs(table["measured"].to_numpy()).max(initial=1e-300))
            factor = math.floor(math.log10(size))
            for column, colour, width in (
                ("predicted", "#bbbbbb", 4),
                ("measured", look_of(method).colour, 1),
            ):
                scaled = table[column] / 10.0**factor
                axes.plot(table["x"], scaled, color=colour, lw=width, label=column)
            axes.set_title(f"{method_title(method)}, × {power_of_ten(factor)}", loc="left")
            axes.tick_params(labelsize=7, labelbottom=True)
        for axes in panels[len(found) :]:
            axes.axis("off")
            axes.plot([], [], color="#bbbbbb", lw=4, label="predicted")
            axes.plot([], [], color="#000000", lw=1, label="measured")
            axes.legend(loc="center")
        figure.supxlabel("time (s), two periods of the spring", fontsize=9)
        figure.supylabel("energy error / energy", fontsize=9)
        figure.tight_layout()
    return figure


def draw_precision(curves: pl.DataFrame) -> Figure:
    """In float32, below which step does a shorter one make things worse?"""
    with styled():
        figure, axes = _one_panel("step dt (s)", "largest position error / size of the motion")
        log_scale(axes, "x", "y")
        for i, (name, table) in enumerate(_series(curves, "precision")):
            table = table.sort("x").filter(pl.col("measured").is_finite())
            colour, line = _SCENARIOS[i % len(_SCENARIOS)]
            axes.plot(table["x"], table["measured"], color=colour, linestyle=line, label=name)
            best = table.sort("measured").head(1)
            axes.plot(best["x"], best["measured"], color=colour, marker="o")
        axes.plot([], [], color="#444444", marker="o", lw=0, label="least error")
        axes.set_ylim(top=3.0)
        _legend(figure, axes)
    return figure


def draw_rounding(curves: pl.DataFrame) -> Figure:
    """How does the rounding of float32 grow with time?"""
    with styled():
        figure, axes = _one_panel("time (s)", "float32 − float64, so far at most (see key)")
        log_scale(axes, "x", "y")
        colours: dict[str, str] = {}
        for name, table in _series(curves, "rounding-growth"):
            scenario, _, quantity = name.partition(", ")
            colour = colours.setdefault(scenario, _SCENARIOS[len(colours)][0])
            line = "-" if quantity == "energy" else (0, (4, 1.5))
            unit = "energy / scale" if quantity == "energy" else "position (m)"
            axes.plot(
                table["x"],
                table["measured"],
                color=colour,
                linestyle=line,
                label=f"{scenario}, {unit}",
            )
        _growth_guides(axes)
        _legend(figure, axes)
    return figure


def _growth_guides(axes: Axes) -> None:
    """Lines of growth as t^(1/2) and as t."""
    (left, right), low = axes.get_xlim(), axes.get_ylim()[0] / 10.0  # beneath the data
    for power, text in ((0.5, "√t"), (1.0, "t")):
        begin, end = left * 3, right / 3
        axes.plot([begin, end], [low, low * (end / begin) ** power], color="#999999", lw=0.7)
        axes.annotate(
            text,
            (end, low * (end / begin) ** power),
            fontsize=7,
            color="#777777",
            ha="center",
            va="center",
            bbox={"color": "white", "pad": 1},
        )


def draw_repair(curves: pl.DataFrame) -> Figure:
    """Which half of the repair makes the pipeline second order?"""
    with styled():
        figure, axes = _one_panel("step dt (s)", "largest position error on the spring (m)")
        log_scale(axes, "x", "y")
        for method, table in _series(curves, "repair"):
            look = _HALVES.get(method) or look_of(method)
            axes.plot(
                table["x"],
                table["measured"],
                color=look.colour,
                linestyle=look.line,
                marker=look.marker,
                label=method_title(method),
            )
        slope_guides(axes)
        _legend(figure, axes)
    return figure


FIGURES: dict[str, Callable[[pl.DataFrame], Figure]] = {
    "stability": draw_stability,
    "backward-error": draw_backward_error,
    "precision": draw_precision,
    "rounding-growth": draw_rounding,
    "repair": draw_repair,
}
"""The figure of each proof that has curves."""
