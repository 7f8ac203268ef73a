"""What the results hold of one scenario, and how it is looked up: what figures and pages share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import polars as pl

from umbra_bench.methods import METHODS


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

    def own_precision(self, method: str) -> str:
        """Float64, or the only precision that a method was run in."""
        return str(one_precision(self.runs, method)["precision"][0])

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


def at_default_step(tables: ScenarioTables, method: str, precision: str) -> dict[str, Any] | None:
    """The run of a method at the default step, if there is one."""
    rows = tables.runs.filter(
        (pl.col("method") == method)
        & (pl.col("precision") == precision)
        & (pl.col("dt") == tables.default_step)
    )
    return rows.to_dicts()[0] if not rows.is_empty() else None
