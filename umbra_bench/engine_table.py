"""The engines of a study side by side: what each was found to be, and what it does to the energy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any

import polars as pl

from umbra_bench.errors import UmbraBenchError
from umbra_bench.identify import examine
from umbra_bench.methods import find_method
from umbra_bench.parallel import map_in_processes

ENGINES_SCHEMA: dict[str, Any] = {
    "method": pl.String,
    "version": pl.String,
    "precision": pl.String,
    "integrator": pl.String,
    "velocity": pl.String,
    "position_order": pl.Float64,
    "energy_error_100": pl.Float64,
    "energy_error_60": pl.Float64,
}


def examine_engines(
    methods: Sequence[str],
    *,
    processes: int | None = 1,
    listener: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> pl.DataFrame:
    """One row (`ENGINES_SCHEMA`) an engine among `methods`, UMBRA's pipelines beside them.

    Without a foreign engine among them there is nothing to compare: no rows.
    """
    wanted = [name for name in methods if find_method(name).kind in ("umbra", "engine")]
    if all(find_method(name).kind == "umbra" for name in wanted):
        wanted = []
    rows = []
    for name, row in zip(wanted, map_in_processes(_row, wanted, processes), strict=True):
        rows.append(row)
        listener(name, len(rows), len(wanted))
    return pl.DataFrame([row for row in rows if row is not None], ENGINES_SCHEMA)


def _row(method: str) -> dict[str, Any] | None:
    try:
        found = examine(method)
    except UmbraBenchError:  # it runs none of the scenarios: the study's skips say why
        return None
    distribution = find_method(method).distribution
    return {
        "method": method,
        "version": metadata.version(distribution) if distribution else "",
        "precision": find_method(method).precision or "either",
        "integrator": found.identity.integrator,
        "velocity": found.identity.velocity,
        "position_order": found.position_order,
        "energy_error_100": found.energy_100,
        "energy_error_60": found.energy_60,
    }
