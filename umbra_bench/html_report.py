"""The report as one self-contained page: `index.html`, with an explorer, from the tables alone.

Nothing is fetched: the plotting library (Plotly), the data, styles and script stand in the page. Series
are packed as float32 in base64, thinned to what a screen shows.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import polars as pl
from markupsafe import Markup, escape
from plotly.offline import get_plotlyjs

from umbra_bench import findings
from umbra_bench.drift_figures import LongRuns, largest
from umbra_bench.metrics import FLOOR_FACTOR
from umbra_bench.overview import overview
from umbra_bench.plots import envelope, look_of
from umbra_bench.scenario_tables import ScenarioTables, at_default_step, methods_of
from umbra_bench.schemas import ENGINE_STEPS
from umbra_bench.wording import method_title, number

POINTS = 200
"""How many samples of a series the page holds."""

_TEMPLATES = Path(__file__).parent / "templates" / "html"


def render_html(
    tables: Sequence[ScenarioTables],
    *,
    claims: dict[str, Any] | None,
    engines: Sequence[dict[str, Any]],
    skips: Sequence[dict[str, Any]],
    environment: dict[str, Any],
    changed: Any = None,
    curves: pl.DataFrame | None = None,
    long_runs: Sequence[LongRuns] = (),
) -> str:
    """The page. Everything that an author wrote is escaped.

    `changed`: :class:`umbra_bench.report.Changed`, where the run is compared with another.
    `curves`: of the claims' figures, where they were measured.
    `long_runs`: what `umbra-bench drift` left.
    """
    page = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    page.filters.update(number=number, title_of=method_title)
    return page.get_template("index.html.j2").render(
        findings=_emphasised(findings.paragraph(tables, claims)),
        overview=overview(tables),
        matrix=_matrix(tables),
        scenarios=[{"tables": t, "caption": findings.caption("error", t)} for t in tables],
        claims=claims,
        long_runs=[
            {"runs": runs, "caption": findings.long_runs_caption(runs.laws.to_dicts())}
            for runs in long_runs
        ],
        engines=engines,
        engine_steps=ENGINE_STEPS,
        skips=skips,
        references=[t.reference for t in tables],
        environment=environment,
        changed=changed,
        style=Markup((_TEMPLATES / "style.css").read_text(encoding="utf-8")),  # noqa: S704
        script=Markup((_TEMPLATES / "explorer.js").read_text(encoding="utf-8")),  # noqa: S704
        plotly=Markup(get_plotlyjs()),  # noqa: S704 -- the library's own text
        data=_script_json(
            {
                **explorer_data(tables),
                "stability": _stability(curves),
                "long_runs": [_long_runs_data(runs) for runs in long_runs],
            }
        ),
    )


def _emphasised(text: str) -> Markup:
    """Markdown's **bold**, `code` and the link to the claims, as HTML; all else is escaped."""
    html = str(escape(text)).replace(
        "([all of them](claims.md))", '(<a href="#claims">all of them</a>)'
    )
    for mark, tag in (("**", "strong"), ("`", "code")):
        parts = html.split(mark)
        html = "".join(
            part if i % 2 == 0 else f"<{tag}>{part}</{tag}>" for i, part in enumerate(parts)
        )
    return Markup(html)  # noqa: S704 -- escaped above


def _script_json(value: Any) -> Markup:
    """JSON that ends no script element, whatever is in it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)  # noqa: S704 -- escaped above


def _matrix(tables: Sequence[ScenarioTables]) -> list[dict[str, Any]]:
    """Methods against scenarios in float64 (an engine's own precision): a cell each."""
    rows = []
    for method in methods_of(tables):
        cells: list[dict[str, Any] | None] = []
        for t in tables:
            if method not in t.methods:
                cells.append(None)
                continue
            precision = t.own_precision(method)
            run = at_default_step(t, method, precision)
            if run is None:
                cells.append(None)
                continue
            cells.append(
                {
                    "order": findings.order_text(t, method, precision, "position"),
                    "energy": run["energy_error_max"],
                    "fate": findings.energy_fate(run, t),
                }
            )
        rows.append({"method": method, "cells": cells})
    return rows


def explorer_data(tables: Sequence[ScenarioTables]) -> dict[str, Any]:
    """What the explorer draws: methods with their looks, and the series of every scenario."""
    methods = methods_of(tables)
    return {
        "methods": [
            {"name": name, "title": method_title(name), "colour": look_of(name).colour}
            | {"dash": _dash(look_of(name).line), "symbol": _SYMBOLS[look_of(name).marker]}
            for name in methods
        ],
        "scenarios": [_scenario_data(t) for t in tables],
    }


def _long_runs_data(runs: LongRuns) -> list[dict[str, Any]]:
    lines = []
    for row in runs.laws.to_dicts():
        series = _of(runs.series, row["method"], row["precision"])
        series = series.filter(pl.col("dt") == row["dt"])
        lines.append(
            {
                **{key: row[key] for key in ("method", "precision", "dt", "law")},
                "colour": look_of(row["method"]).colour,
                "dash": "dot" if row["precision"] == "float32" else "solid",
                "title": f"{method_title(row['method'])}, {row['precision']}",
                "steps": series["step"].to_list(),
                "error": _finite(pl.Series(largest(series))),
            }
        )
    return lines


def _stability(curves: pl.DataFrame | None) -> list[dict[str, Any]]:
    """Growth per step against omega dt: each method measured, and what theory says."""
    if curves is None:
        return []
    table = curves.filter(pl.col("proof") == "stability")
    found = []
    for series in table["series"].unique(maintain_order=True):
        rows = table.filter(pl.col("series") == series)
        method, _, damped = series.partition(", ")
        look = look_of(method)
        found.append(
            {
                "title": method_title(method) + (f", {damped}" if damped else ""),
                "colour": look.colour,
                "dash": "dot" if damped else _dash(look.line),
                **{name: rows[name].to_list() for name in ("x", "measured", "predicted")},
            }
        )
    return found


_SYMBOLS = {
    "v": "triangle-down",
    "^": "triangle-up",
    "<": "triangle-left",
    ">": "triangle-right",
    "s": "square",
    "D": "diamond",
    "d": "diamond-tall",
    "P": "cross",
    "o": "circle",
    "X": "x",
    "*": "star",
    "p": "pentagon",
    "h": "hexagon",
    "8": "octagon",
}
"""Plotly's names of the markers of the figures."""


def _dash(line: Any) -> str:
    if line == "-":
        return "solid"
    return "dash" if line[1][0] > 2 else "dot"


def _scenario_data(t: ScenarioTables) -> dict[str, Any]:
    body = t.scenario["bodies"][0]["name"]
    lines = [
        _line_data(t, method, precision, body)
        for method in t.methods
        for precision in ("float64", "float32")
        if not _of(t.runs, method, precision).is_empty()
    ]
    truth = _of(t.motion, "reference", "float64").filter(pl.col("body") == body)
    return {
        "name": t.scenario["name"],
        "title": t.scenario["title"],
        "description": t.scenario["description"],
        "family": t.scenario["family"],
        "body": body,
        "step": t.default_step,
        "floors": {
            quantity: FLOOR_FACTOR * t.reference[f"{quantity}_bound"]
            for quantity in ("position", "velocity", "energy")
        },
        "reference": _motion_data(truth),
        "lines": lines,
    }


def _line_data(t: ScenarioTables, method: str, precision: str, body: str) -> dict[str, Any]:
    runs = _of(t.runs, method, precision).sort("dt")
    energy = _of(t.energy, method, precision).sort("t")
    motion = _of(t.motion, method, precision).filter(pl.col("body") == body)
    data: dict[str, Any] = {
        "method": method,
        "precision": precision,
        "orders": {
            quantity: findings.order_text(t, method, precision, quantity)
            for quantity in ("position", "velocity", "energy")
        },
        "dt": runs["dt"].to_list(),
        "position": _finite(runs["position_error_max"]),
        "velocity": _finite(runs["velocity_error_max"]),
        "energy": _finite(runs["energy_error_max"]),
        "diverged": runs["diverged_at"].to_list(),
    }
    if not energy.is_empty():
        time, size = envelope(energy)  # samples would miss the peaks between them
        data["over_time"] = {"t": _packed(time), "error": _packed(size)}
    if not motion.is_empty():
        data["motion"] = _motion_data(motion)
    return data


def _motion_data(motion: pl.DataFrame) -> dict[str, str]:
    motion = motion.sort("t")
    chosen = _chosen(motion.height)
    return {
        name: _packed(motion[name].to_numpy()[chosen]) for name in ("t", "x", "y", "angle", "vx")
    }


def _of(table: pl.DataFrame, method: str, precision: str) -> pl.DataFrame:
    return table.filter((pl.col("method") == method) & (pl.col("precision") == precision))


def _chosen(count: int) -> np.ndarray:
    """Which of the samples are kept, the first and the last included."""
    return np.unique(np.linspace(0, count - 1, min(count, POINTS)).astype(int))


def _packed(values: np.ndarray) -> str:
    with np.errstate(over="ignore"):
        return base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")


def _finite(values: pl.Series) -> list[float | None]:
    return [v if v is not None and np.isfinite(v) else None for v in values]
