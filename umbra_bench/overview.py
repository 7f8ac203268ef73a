"""Methods against scenarios at a glance: order, energy at the default step, and where it leads."""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Sequence
from typing import Any, NamedTuple

from rich.console import Console
from rich.table import Table

from umbra_bench.findings import energy_fate, orders_of_position
from umbra_bench.scenario_tables import ScenarioTables, at_default_step, methods_of
from umbra_bench.wording import method_title, number


class Row(NamedTuple):
    """A method over all scenarios that it ran, in the precision named.

    Attributes:
        order: the median of its observed orders of position; NaN where none shows.
        orders: how many scenarios show one.
        scenarios: how many it ran.
        energy: the median of its largest energy errors at the default steps, over the energy scale.
        worst, worst_scenario: the largest of them, and where.
        gains, loses, diverged: on how many scenarios its energy drifts up, drifts down, or leaves.
    """

    method: str
    precision: str
    order: float
    orders: int
    scenarios: int
    energy: float
    worst: float
    worst_scenario: str
    gains: int
    loses: int
    diverged: int


def overview(tables: Sequence[ScenarioTables]) -> list[Row]:
    """One row a method, in float64 where it has a choice."""
    rows = []
    for method in methods_of(tables):
        for precision in ("float64", "float32"):
            runs = {
                t.scenario["name"]: (run, t)
                for t in tables
                if (run := at_default_step(t, method, precision)) is not None
            }
            if runs:
                rows.append(_row(method, precision, runs, tables))
                break
    return rows


def _row(
    method: str,
    precision: str,
    runs: dict[str, tuple[dict[str, Any], ScenarioTables]],
    tables: Sequence[ScenarioTables],
) -> Row:
    orders = list(orders_of_position(tables, method, precision).values())
    errors = {
        name: run["energy_error_max"] if run["diverged_at"] is None else math.inf
        for name, (run, _) in runs.items()
    }
    worst = max(errors, key=lambda name: errors[name])
    fates = [energy_fate(run, t) for run, t in runs.values()]
    return Row(
        method=method,
        precision=precision,
        order=statistics.median(orders) if orders else math.nan,
        orders=len(orders),
        scenarios=len(runs),
        energy=statistics.median(errors.values()),
        worst=errors[worst],
        worst_scenario=worst,
        gains=fates.count("gains"),
        loses=fates.count("loses"),
        diverged=fates.count("diverged"),
    )


def print_overview(tables: Sequence[ScenarioTables]) -> None:
    """Print the overview as a table that fits 100 columns."""
    console = Console(width=None if os.isatty(1) else 100, highlight=False)
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("method", no_wrap=True)
    for column in ("order", "energy error", "largest", "gains", "loses", "div."):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("largest on", no_wrap=True)
    for row in overview(tables):
        table.add_row(
            method_title(row.method)[:28],
            "none" if math.isnan(row.order) else f"{row.order:.2f}",
            number(row.energy),
            number(row.worst),
            *(str(count or "") for count in (row.gains, row.loses, row.diverged)),
            row.worst_scenario[:18],
        )
    console.print(table)
    console.print(
        "order: median over the scenarios that show one. energy error: median of the largest errors\n"
        "at the default steps, over the energy scale. gains, loses, div.: on how many scenarios energy\n"
        "drifts up, drifts down or leaves.",
        markup=False,
    )
