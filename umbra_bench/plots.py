"""Results to pictures: each figure answers one question, drawn from the tables alone.

One colour, one line and one marker a method, everywhere. The colours of this project's methods are
those of Okabe and Ito, which colour-blind readers can tell apart; engines, dotted, have their markers.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from umbra_bench.findings import order_text
from umbra_bench.metrics import FLOOR_FACTOR
from umbra_bench.results import replacing
from umbra_bench.scenario_tables import ScenarioTables, at_default_step, methods_of, one_precision
from umbra_bench.wording import method_title, number


class Look(NamedTuple):
    """How a method is drawn."""

    colour: str
    line: Any
    marker: str


LOOKS: dict[str, Look] = {
    "explicit-euler": Look("#D55E00", "-", "v"),
    "semi-implicit-euler": Look("#E69F00", "-", "s"),
    "velocity-verlet": Look("#009E73", "-", "D"),
    "rk4": Look("#56B4E9", "-", "^"),
    "yoshida4": Look("#CC79A7", "-", "P"),
    "umbra": Look("#000000", (0, (4, 1.5)), "o"),
    "umbra-repaired": Look("#0072B2", (0, (4, 1.5)), "X"),
    "pymunk": Look("#8C5A2B", (0, (1, 1)), "<"),
    "pymunk-velocity-func": Look("#777777", (0, (1, 1)), ">"),
    "pymunk-spring": Look("#AAAAAA", (0, (3, 1, 1, 1)), "*"),
    "box2d": Look("#7A3E9D", (0, (1, 1)), "s"),
    "bullet": Look("#B22222", (0, (1, 1)), "d"),
    "physx": Look("#5A7D00", (0, (1, 1)), "p"),
    "mujoco-euler": Look("#0B5351", (0, (1, 1)), "h"),
    "mujoco-rk4": Look("#3D5AFE", (0, (1, 1)), "8"),
}
_UNKNOWN = Look("#444444", (0, (5, 1, 1, 1, 1, 1)), "h")


def look_of(method: str) -> Look:
    """How a method is drawn; one that nobody thought of is grey."""
    return LOOKS.get(method, _UNKNOWN)


PRECISIONS = ("float64", "float32")
CLIP = 1e6
"""A log axis ends at this multiple of the motion's scale: what is beyond has diverged."""

WINDOWS = 120
"""A run's energy error is drawn as its largest value in each of this many parts."""


def draw_error(tables: ScenarioTables) -> Figure:
    """How does the position error shrink with the step?"""
    return _draw_against_dt(tables, "position", "largest position error (m)")


def draw_energy(tables: ScenarioTables) -> Figure:
    """How does the largest energy error shrink with the step?"""
    return _draw_against_dt(tables, "energy", "largest energy error / energy scale")


def _draw_against_dt(tables: ScenarioTables, quantity: str, label: str) -> Figure:
    with styled():
        figure, panels = _panels(label)
        for axes, precision in zip(panels, PRECISIONS, strict=True):
            _plot_against_dt(axes, tables, precision, f"{quantity}_error_max")
        floor = FLOOR_FACTOR * tables.reference[f"{quantity}_bound"]
        _finish_log_panels(panels, floor, "floor of the reference")
        if tables.orders.filter(pl.col("quantity") == quantity)["order"].is_finite().any():
            for axes in panels:
                if axes.get_lines():
                    slope_guides(axes)
        if any(text.get_text().startswith("▲") for axes in panels for text in axes.texts):
            figure.text(0.71, 0.03, "▲ how many methods diverged", fontsize=7, color="#555555")
        _legend(figure, tables, quantity)
    return figure


def draw_energy_over_time(tables: ScenarioTables) -> Figure:
    """At the default step, does the energy error stay bounded, drift or grow?"""
    with styled():
        figure, panels = _panels("|energy error| / energy scale", "time (s)")
        for axes, precision in zip(panels, PRECISIONS, strict=True):
            log_scale(axes, "y")
            axes.set_title(f"{precision}, dt = {tables.default_step:g} s", loc="left")
            for row, method in enumerate(tables.methods):
                series = _line(tables.energy, method, precision).sort("t")
                if series.is_empty():
                    continue
                axes.set_xlim(0.0, series["t"][-1])
                time, size = envelope(series)
                if np.isnan(size).all():
                    continue
                look = look_of(method)
                axes.plot(
                    time,
                    size,
                    color=look.colour,
                    linestyle=look.line,
                    lw=1.0,
                    marker=look.marker,
                    markevery=(row, max(len(tables.methods), 15)),
                )
                run = at_default_step(tables, method, precision)
                if run and run["diverged_at"] is not None:
                    mark_beyond(axes, run["diverged_at"], look.colour)
            if not axes.get_lines():
                _say(axes, "no method shows any energy error")
        _finish_log_panels(
            panels, FLOOR_FACTOR * tables.reference["energy_bound"], "floor of the reference"
        )
        _legend(figure, tables, None)
    return figure


def envelope(series: pl.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """The largest size of the energy error in each of `WINDOWS` equal parts of a run, at its time.

    What swings faster than a window is a line at its crest; a window without an error that a log axis
    can show is not a number.
    """
    time = series["t"].to_numpy()
    with np.errstate(all="ignore"):
        size = np.fmax(abs(series["lowest"].to_numpy()), abs(series["highest"].to_numpy()))
    size = np.where(np.isfinite(size) & (size < CLIP) & (size > 0), size, -np.inf)
    window = np.minimum(WINDOWS * time / time[-1], WINDOWS - 1).astype(int)
    starts = np.flatnonzero(np.diff(window, prepend=-1))
    ends = np.append(starts[1:], len(size))
    crests = [
        begin + int(size[begin:end].argmax()) for begin, end in zip(starts, ends, strict=True)
    ]
    return time[crests], np.where(size[crests] > 0, size[crests], np.nan)


def draw_orders(tables: Sequence[ScenarioTables]) -> Figure:
    """Which order of position does each method really have? In float64, or in its own precision."""
    orders = pl.concat([t.orders for t in tables]).filter(pl.col("quantity") == "position")
    methods = methods_of(tables)
    with styled():
        figure = Figure(figsize=(9.2, 0.9 + 0.26 * len(methods)))
        FigureCanvasAgg(figure)
        whole, rest = figure.subplots(
            1, 2, sharey=True, gridspec_kw={"left": 0.26, "right": 0.985, "wspace": 0.06}
        )
        figure.subplots_adjust(bottom=0.5 / figure.get_figheight(), top=0.97)
        labels = []
        for row, method in enumerate(methods):
            found = one_precision(orders, method)
            shown = found.filter(pl.col("order").is_finite())
            labels.append(f"{_label(method)}  {shown.height} of {found.height}")
            order = shown["order"].to_numpy()
            look = look_of(method)
            place = row + np.linspace(-0.3, 0.3, shown.height) if shown.height > 1 else [row]
            for axes, value in ((whole, order), (rest, order - np.round(order))):
                axes.errorbar(
                    value,
                    place[: shown.height],
                    xerr=shown["standard_error"].to_numpy(),
                    color=look.colour,
                    marker=look.marker,
                    linestyle="none",
                    elinewidth=1.0,
                )
        whole.set_yticks(range(len(methods)), labels)
        whole.set_ylim(len(methods) - 0.4, -0.6)
        whole.set_xlim(0.4, 5.4)
        rest.xaxis.set_major_locator(MaxNLocator(5))
        rest.axvline(0.0, color="#777777", lw=0.7)
        whole.set_xlabel("observed order of position, by scenario")
        rest.set_xlabel("distance from a whole order ± standard error")
    return figure


def draw_motion(tables: ScenarioTables) -> Figure:
    """What does the motion look like at the default step, and who leaves it?"""
    picture = _PICTURES[tables.scenario["family"]]
    timed = picture.x_label.startswith("time")
    with styled():
        figure = Figure(figsize=(7.2, 3.9))
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0.105, 0.13, 0.525, 0.78))
        body = tables.scenario["bodies"][0]["name"]
        truth = _line(tables.motion, "reference", "float64").filter(pl.col("body") == body)
        x, y = picture.curve(truth, math.inf)
        sparse, shown = (False, len(x)) if timed else _window(x, y)
        x, y = x[:shown], y[:shown]
        size = 1e6 * max(float(np.nanmax(np.abs(values))) for values in (x, y))
        dots: dict[str, Any] = {"linestyle": "none", "marker": "o"} if sparse else {}
        axes.plot(
            x, y, color="#cfcfcf", lw=5, solid_capstyle="round", label="Reference", zorder=1, **dots
        )
        title = f"{body}, float64, dt = {tables.default_step:g} s"
        if sparse:
            title += f", every {truth['t'][1] - truth['t'][0]:.2g} s"
        elif shown < truth.height:
            title += f", until {truth['t'][shown - 1]:.2g} s"
        axes.set_title(title, loc="left", parse_math=False)
        axes.set_xlabel(picture.x_label)
        axes.set_ylabel(picture.y_label)
        if timed:
            axes.set_xlim(x[0], x[-1])
        else:
            _limit(axes.set_xlim, x)
        _limit(axes.set_ylim, y)
        if picture.equal:
            axes.set_aspect("equal", adjustable="box")
        for row, method in enumerate(tables.methods):
            precision = tables.own_precision(method)
            path = _line(tables.motion, method, precision).filter(pl.col("body") == body)
            look = look_of(method)
            mx, my = (values[:shown] for values in picture.curve(path, size))
            axes.plot(
                mx,
                my,
                color=look.colour,
                linestyle="none" if sparse else look.line,
                lw=0.9,
                marker=look.marker,
                markersize=1.5 if sparse else None if timed else 6,
                markevery=None if sparse else (3 * row, 45) if timed else [len(mx) - 1],
                label=_label(method) + ("" if precision == "float64" else f" ({precision})"),
            )
            _mark_leaving(axes, mx, my, look.colour)
        figure.legend(
            *axes.get_legend_handles_labels(), loc="center left", bbox_to_anchor=(0.65, 0.5)
        )
    return figure


TURNS = 8
"""A path in a plane is drawn for so many turns: beyond them it is a tangle."""

SPARSE = 0.7
"""Samples between which a path turns by more than this, in rad, are dots: chords would lie."""


def _window(x: np.ndarray, y: np.ndarray) -> tuple[bool, int]:
    """Whether the samples of a path are sparse, and how many of them are drawn."""
    chords = np.diff(x) / (np.ptp(x) or 1.0) + 1j * np.diff(y) / (np.ptp(y) or 1.0)
    turns = np.abs(np.angle(chords[1:] * chords[:-1].conj()))
    sparse = bool(turns.size) and float(np.median(turns)) > SPARSE
    within = int(np.searchsorted(turns.cumsum(), 2 * math.pi * TURNS))
    return sparse, len(x) if sparse or within == turns.size else within + 2


def _mark_leaving(axes: Axes, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """A triangle on the frame where a path leaves it, pointing where it goes."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    with np.errstate(invalid="ignore"):
        within = (x >= left) & (x <= right) & (y >= low) & (y <= high)
    out = int(within.argmin()) if within.size else 0
    if out == 0 or within[out]:  # it never leaves, or was never there
        return
    last = out if np.isfinite(x[out] + y[out]) else out - 1
    across, up = (x[last] - x[last - 1]) / (right - left), (y[last] - y[last - 1]) / (high - low)
    axes.scatter(
        [np.clip(x[last], left, right)],
        [np.clip(y[last], low, high)],
        marker=(3, 0, round(math.degrees(math.atan2(up, across))) - 90),
        s=30,
        color=colour,
        clip_on=False,
        zorder=5,
    )


def mark_beyond(axes: Axes, x: float, colour: str) -> None:
    """A triangle at the top of a panel, where a curve has left through it."""
    top = axes.get_xaxis_transform()
    axes.scatter([x], [1.0], marker="^", s=20, color=colour, transform=top, clip_on=False, zorder=5)


class Picture(NamedTuple):
    """Which two quantities show a motion of one family."""

    curve: Callable[[pl.DataFrame, float], tuple[np.ndarray, np.ndarray]]
    x_label: str
    y_label: str
    equal: bool = False


def _columns(x: str, y: str) -> Callable[[pl.DataFrame, float], tuple[np.ndarray, np.ndarray]]:
    def curve(table: pl.DataFrame, size: float) -> tuple[np.ndarray, np.ndarray]:
        values = table[y].to_numpy()
        if y == "angle":
            with np.errstate(all="ignore"):
                values = np.unwrap(values)
        return _drawable(table[x].to_numpy(), size), _drawable(values, size)

    return curve


def _drawable(values: np.ndarray, size: float) -> np.ndarray:
    """Without what is beyond `size`, which no canvas holds: a diverged curve ends."""
    with np.errstate(all="ignore"):
        return np.where(np.abs(values) < size, values, np.nan)


_PICTURES: dict[str, Picture] = {
    "spring": Picture(_columns("x", "vx"), "x (m)", "velocity in x (m/s)"),
    "orbit": Picture(_columns("x", "y"), "x (m)", "y (m)", equal=True),
    "free_fall": Picture(_columns("t", "y"), "time (s)", "height (m)"),
    "rotation": Picture(_columns("t", "angle"), "time (s)", "angle (rad)"),
}


def save(figure: Figure, path: Path, formats: Sequence[str] = ("svg", "png")) -> Path:
    """Write a figure in each of the formats; the same figure gives the same bytes.

    `path`: without an ending; it is returned.

    Raises:
        UmbraBenchError: the folder or a file cannot be written.
    """
    for ending in formats:
        metadata = {"Date": None} if ending == "svg" else {}
        with styled(), replacing(path.with_name(f"{path.name}.{ending}")) as temporary:
            figure.savefig(temporary, format=ending, metadata=metadata)
    return path


# Parts of figures ---------------------------------------------------------------------------------


@contextmanager
def styled() -> Iterator[None]:
    """The style of all figures."""
    with mpl.rc_context(_style()):
        yield


@functools.cache
def _style() -> mpl.RcParams:
    """The style file, read once."""
    with resources.as_file(resources.files("umbra_bench") / "report.mplstyle") as path:
        return mpl.rc_params_from_file(path, use_default_template=False)


def _panels(y_label: str, x_label: str = "step dt (s)") -> tuple[Figure, list[Axes]]:
    """Two panels, float64 and float32, with one y axis and room for a legend on the right."""
    figure = Figure(figsize=(9.6, 3.7))
    FigureCanvasAgg(figure)
    left = figure.add_axes((0.073, 0.14, 0.297, 0.77))
    right = figure.add_axes((0.396, 0.14, 0.297, 0.77), sharex=left, sharey=left)
    right.tick_params(labelleft=False)
    left.set_ylabel(y_label)
    left.yaxis.set_label_coords(-0.165, 0.5)
    for axes in (left, right):
        axes.set_xlabel(x_label)
        axes.xaxis.set_label_coords(0.5, -0.11)
    return figure, [left, right]


def _plot_against_dt(axes: Axes, tables: ScenarioTables, precision: str, column: str) -> None:
    scale = tables.reference["length_scale"] if column.startswith("position") else 1.0
    log_scale(axes, "x", "y")
    axes.set_title(precision, loc="left")
    for method in tables.methods:
        look = look_of(method)
        if tables.before is not None:
            old = _drawn(tables.before.runs, method, precision, column, scale)
            axes.plot(old["dt"], old[column], color=look.colour, lw=5, alpha=0.25, zorder=1.2)
        good = _drawn(tables.runs, method, precision, column, scale)
        if good.is_empty():
            continue
        axes.plot(
            good["dt"], good[column], color=look.colour, linestyle=look.line, marker=look.marker
        )
    if not axes.get_lines():
        _say(axes, _why_nothing(tables.runs.filter(pl.col("precision") == precision)[column]))
        return
    for dt, count in _beyond(tables.runs, precision, column, scale).rows():
        axes.update_datalim([(dt, 1.0)], updatey=False)
        top = axes.get_xaxis_transform()
        axes.text(dt, 1.0, f"▲{count}", transform=top, fontsize=6.5, color="#555555", ha="center")
    axes.autoscale_view(scaley=False)


def _why_nothing(errors: pl.Series) -> str:
    if errors.is_empty():
        return "no method was run"
    if (errors == 0.0).all():
        return "every error is exactly zero"
    return (
        "every method has diverged" if (errors != 0.0).all() else "every error is zero or infinite"
    )


def _beyond(runs: pl.DataFrame, precision: str, column: str, scale: float) -> pl.DataFrame:
    """At how many methods, by step, the error is beyond what is drawn: they have diverged."""
    beyond = pl.col(column).is_nan() | (pl.col(column) >= CLIP * scale)
    return runs.filter((pl.col("precision") == precision) & beyond).group_by("dt").len().sort("dt")


def _drawn(
    runs: pl.DataFrame, method: str, precision: str, column: str, scale: float
) -> pl.DataFrame:
    """The points of a line that a log axis can show."""
    value = pl.col(column)
    shown = value.is_finite() & (value > 0) & (value < CLIP * scale)
    return _line(runs, method, precision).sort("dt").filter(shown)


_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def log_scale(axes: Axes, *names: str) -> None:
    """Make axes logarithmic, with powers of ten as text: formulas take a third of a figure's time."""
    for name in names:
        getattr(axes, f"set_{name}scale")("log")
        axis = getattr(axes, f"{name}axis")
        axis.set_major_formatter(FuncFormatter(_power_tick))
        axis.set_minor_formatter(NullFormatter())
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))


def _power_tick(value: float, _: int) -> str:
    return power_of_ten(round(math.log10(value)))


def power_of_ten(exponent: int) -> str:
    """A power of ten as text."""
    return f"10{str(exponent).translate(_SUPERSCRIPTS)}"


def _say(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", color="#777777")


def _finish_log_panels(panels: list[Axes], floor: float, label: str) -> None:
    """Limits that show all data, the reference's floor shaded, and sensible ticks."""
    values = np.concatenate(
        [np.asarray(line.get_ydata(), float) for axes in panels for line in axes.get_lines()]
        or [np.array([1.0])]
    )
    values = values[np.isfinite(values) & (values > 0)]
    least = values.min(initial=1.0)
    low = min(least / 30, max(floor / 30, least / 100))  # a floor far below would squeeze the data
    high = values.max(initial=floor) * 3
    for axes in panels:
        axes.set_ylim(low, high)
        if floor > low:
            axes.axhspan(low, floor, color="#efefef", zorder=0)
        decades = math.log10(high / low)
        axes.yaxis.set_major_locator(LogLocator(numticks=8 if decades > 8 else 12))
        axes.yaxis.set_minor_locator(NullLocator())
    panels[0].text(
        0.02,
        0.015,
        label if floor > low else f"{label}: {number(floor)}",
        transform=panels[0].transAxes,
        fontsize=7,
        color="#777777",
    )


def slope_guides(axes: Axes) -> None:
    """Short lines of slope 1, 2 and 4, labelled, in a corner that no curve crosses, if there is one."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    run = math.log10(4.0) / math.log10(right / left)
    rises = {s: s * math.log10(4.0) / math.log10(high / low) for s in (1, 2, 4)}
    rises = {slope: rise for slope, rise in rises.items() if rise < 0.4}
    if not rises:
        return
    width, height = run + 0.04, max(rises.values())
    taken = np.concatenate([_along(axes, line) for line in axes.get_lines()])
    corners = ((0.97 - width, 0.04), (0.03, 0.96 - height), (0.97 - width, 0.96 - height))
    for x, y in corners:
        apart = np.abs(taken - (x + width / 2, y + height / 2)) > (width / 2, height / 2 + 0.02)
        if apart.any(axis=1).all():
            break
    else:
        return
    for slope, rise in rises.items():
        ends: dict[str, Any] = {
            "transform": axes.transAxes,
            "color": "#999999",
            "lw": 0.7,
            "zorder": 1.5,
        }
        axes.plot([x, x + run], [y, y + rise], **ends)
        axes.text(
            x + run + 0.01,
            y + rise,
            f"{slope}",
            transform=axes.transAxes,
            fontsize=7,
            color="#777777",
            va="center",
        )
    axes.set_xlim(left, right)


def _along(axes: Axes, line: mpl.lines.Line2D) -> np.ndarray:
    """Places along a curve, in parts of a panel, shape (K, 2)."""
    places = axes.transAxes.inverted().transform(axes.transData.transform(line.get_xydata()))
    index = np.arange(len(places))
    between = np.linspace(0.0, max(len(places) - 1.0, 0.0), 12 * len(places))
    return np.column_stack([np.interp(between, index, column) for column in places.T])


def _legend(figure: Figure, tables: ScenarioTables, quantity: str | None) -> None:
    """All methods, with their observed order where a quantity is given."""
    handles, labels = [], []
    for method in tables.methods:
        look = look_of(method)
        handles.append(
            mpl.lines.Line2D([], [], color=look.colour, linestyle=look.line, marker=look.marker)
        )
        precision = tables.own_precision(method)
        labels.append(
            _label(method)
            + (f" ({order_text(tables, method, precision, quantity, 3)})" if quantity else "")
        )
    title = "method (order ± standard error,\nfloat64 or the engine's own precision)"
    figure.legend(
        handles,
        labels,
        loc="center left",
        bbox_to_anchor=(0.703, 0.53),
        title=title if quantity else None,
        title_fontsize=8,
        alignment="left",
    )


def _label(method: str) -> str:
    """The method's name in a legend, where a dollar sign would begin a formula."""
    return method_title(method).replace("$", r"\$")


def _line(table: pl.DataFrame, method: str, precision: str) -> pl.DataFrame:
    return table.filter((pl.col("method") == method) & (pl.col("precision") == precision))


def _limit(setter: Callable[[float, float], Any], values: np.ndarray) -> None:
    """Show the truth and a margin; what flies off is cut."""
    low, high = np.nanmin(values), np.nanmax(values)
    margin = 0.35 * (high - low) or 1.0
    setter(low - margin, high + margin)
