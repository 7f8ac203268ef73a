"""What a study found on one scenario, as tables, and how they are read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from umbra_bench import wording
from umbra_bench.methods import METHODS

EXACT = 1e-9
"""A method whose error at the default step is below this part of the motion's size is exact."""

SECULAR = 0.5
"""Energy that drifts over the run by more than this part of its largest error is gained or lost."""


@dataclass(frozen=True)
class ScenarioTables:
    """Everything in the results that belongs to one scenario.

    `before`: the same of another run, drawn beneath as wide pale lines.
    """

    scenario: dict[str, Any]
    runs: pl.DataFrame
    orders: pl.DataFrame
    reference: dict[str, Any]
    motion: pl.DataFrame
    energy: pl.DataFrame
    before: ScenarioTables | None = None

    @property
    def methods(self) -> list[str]:
        """The methods that were run, in the order of the table of methods."""
        return in_order(self.runs["method"])

    @property
    def default_step(self) -> float:
        """The step at which motion and energy over time are kept, s."""
        return float(self.motion["dt"][0])


def methods_of(tables: Sequence[ScenarioTables]) -> list[str]:
    """All methods of some results, in the order of the table of methods."""
    return in_order(method for t in tables for method in t.methods)


def in_order(methods: Iterable[str]) -> list[str]:
    """Methods, each once, in the order of the table of methods; unknown ones last."""
    found = set(methods)
    return [name for name in METHODS if name in found] + sorted(found - set(METHODS))


def one_precision(table: pl.DataFrame, method: str) -> pl.DataFrame:
    """A method's rows in float64, or in the only precision that it has."""
    rows = table.filter(pl.col("method") == method)
    precisions = rows["precision"].unique()
    return rows.filter(pl.col("precision") == precisions.max()) if len(precisions) else rows


def line_of(table: pl.DataFrame, method: str, precision: str) -> pl.DataFrame:
    """The rows of a method in a precision."""
    return table.filter((pl.col("method") == method) & (pl.col("precision") == precision))


def own_precision(tables: ScenarioTables, method: str) -> str:
    """float64, or the only precision that an engine has."""
    found = one_precision(tables.runs, method)
    return str(found["precision"][0]) if not found.is_empty() else "float64"


def at_default_step(tables: ScenarioTables, method: str, precision: str) -> dict[str, Any] | None:
    """The run of a method at the default step, if there is one."""
    rows = line_of(tables.runs, method, precision).filter(pl.col("dt") == tables.default_step)
    return rows.to_dicts()[0] if not rows.is_empty() else None


def order_text(
    tables: ScenarioTables, method: str, precision: str, quantity: str, decimals: int = 2
) -> str:
    """An observed order with its standard error, or why there is none."""
    row = line_of(tables.orders, method, precision).filter(pl.col("quantity") == quantity)
    if row.is_empty():
        return "–"
    order, error = row.select("order", "standard_error").row(0)
    if math.isfinite(order):
        return wording.order_text(order, error, decimals)
    run = at_default_step(tables, method, precision)
    exact = run and run["position_error_max"] < EXACT * tables.reference["length_scale"]
    return "exact" if exact else "none"


def energy_fate(run: dict[str, Any], tables: ScenarioTables) -> str:
    """What becomes of a run's energy: "exact", "bounded", "gains", "loses" or "diverged"."""
    if run["diverged_at"] is not None or not math.isfinite(run["energy_error_max"]):
        return "diverged"
    if run["energy_error_max"] <= 10 * max(tables.reference["energy_bound"], 1e-15):
        return "exact"
    drifted = run["energy_drift_rate"] * tables.scenario["duration"]
    if abs(drifted) <= SECULAR * run["energy_error_max"]:
        return "bounded"
    return "gains" if drifted > 0.0 else "loses"
