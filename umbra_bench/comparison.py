"""Two runs of a study against each other: what changed beyond the gate's tolerance."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from umbra_bench.metrics import FLOOR_FACTOR, ORDER_DROP, TOLERANCE
from umbra_bench.scenario_tables import ScenarioTables

METRICS = {
    "position_error_max": ("position_bound", "length_scale"),
    "velocity_error_max": ("velocity_bound", "speed_scale"),
    "energy_error_max": ("energy_bound", None),
}
"""The compared columns, with the reference's bound and scale that make their floor."""


class Difference(NamedTuple):
    """A number that changed. `step` is None for an order; a side that has none is None."""

    scenario: str
    method: str
    precision: str
    step: float | None
    metric: str
    before: float | None
    now: float | None

    @property
    def factor(self) -> float | None:
        """How many times the number before the number is now."""
        if not self.before or self.now is None:
            return None
        return self.now / self.before

    @property
    def worse(self) -> bool:
        """Whether an error grew, an order dropped, or a number is there no more."""
        if self.now is None or self.before is None:
            return self.now is None
        return self.now < self.before if self.metric == "order" else self.now > self.before


def beside(now: Sequence[ScenarioTables], before: Sequence[ScenarioTables]) -> list[ScenarioTables]:
    """The tables of a run, each with its scenario's tables of the run before, where it has any."""
    known = {t.scenario["name"]: t for t in before}
    return [dataclasses.replace(t, before=known.get(t.scenario["name"])) for t in now]


def differences(tables: Sequence[ScenarioTables]) -> list[Difference]:
    """All numbers that changed beyond the gate's tolerance, what got worse first."""
    found = [d for t in tables if t.before is not None for d in _of_scenario(t, t.before)]

    def weight(d: Difference) -> tuple[bool, float]:
        factor = d.factor
        return not d.worse, -abs(math.log(factor)) if factor and factor > 0.0 else -math.inf

    return sorted(found, key=weight)


def _of_scenario(now: ScenarioTables, before: ScenarioTables) -> Iterator[Difference]:
    key = ("method", "precision", "dt")
    rows, old = (
        {tuple(row[k] for k in key): row for row in t.runs.to_dicts()} for t in (now, before)
    )
    for line in sorted({*rows, *old}, key=str):
        a, b = old.get(line), rows.get(line)
        for metric, (bound, scale) in METRICS.items():
            one, other = _value(a, metric), _value(b, metric)
            floor = FLOOR_FACTOR * now.reference[bound] + _rounding(b or a, now, scale)
            if _changed(one, other, floor):
                method, precision, step = line
                yield Difference(now.scenario["name"], method, precision, step, metric, one, other)
    orders, old_orders = (
        {
            (row["method"], row["precision"]): row["order"]
            for row in t.orders.to_dicts()
            if row["quantity"] == "position" and math.isfinite(row["order"])
        }
        for t in (now, before)
    )
    for method, precision in sorted({*orders, *old_orders}):
        one, other = old_orders.get((method, precision)), orders.get((method, precision))
        if one is None or other is None or abs(one - other) > ORDER_DROP:
            name = now.scenario["name"]
            yield Difference(name, method, precision, None, "order", one, other)


def _value(row: dict[str, Any] | None, metric: str) -> float | None:
    return None if row is None else float(row[metric])


def _rounding(row: dict[str, Any] | None, tables: ScenarioTables, scale: str | None) -> float:
    """What rounding alone can do over a run: an ulp of the motion's size in every step."""
    assert row is not None
    size = tables.reference[scale] if scale else 1.0
    return float(np.finfo(row["precision"]).eps) * row["steps"] * size


def _changed(before: float | None, now: float | None, floor: float) -> bool:
    if before is None or now is None:
        return True
    if not (math.isfinite(before) and math.isfinite(now)):
        return math.isfinite(before) != math.isfinite(now)
    return abs(now - before) > TOLERANCE * before + floor
