"""Engines examined: what each was found to be, and what it does to the energy of a spring."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from importlib import metadata
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from rich.console import Console
from rich.table import Table

from umbra_bench.errors import UmbraBenchError
from umbra_bench.identify import CANDIDATES, MATCH, STEPS, Identity, identify
from umbra_bench.methods import find_method
from umbra_bench.parallel import map_in_processes
from umbra_bench.reference import certified_reference
from umbra_bench.scenario import Scenario, load_scenario
from umbra_bench.schemas import ENGINE_STEPS, ENGINES_SCHEMA
from umbra_bench.simulation import simulate
from umbra_bench.study import measure, orders_of, run_on_grid
from umbra_bench.wording import number


class Examination(NamedTuple):
    """What a method was found to be, and how it does on the spring.

    Attributes:
        position_order, velocity_order: observed over `ENGINE_STEPS`; NaN where none shows.
        energy_100, energy_60: the largest energy error over the energy scale at 100 and 60 steps a
            second.
    """

    identity: Identity
    position_order: float
    velocity_order: float
    energy_100: float
    energy_60: float


def examine(method: str, scenarios: Sequence[Scenario] = ()) -> Examination:
    """Identify a method and measure it on the spring of the project.

    Raises:
        UmbraBenchError: as :func:`identify`.
    """
    identity = identify(method, scenarios)
    spring = load_scenario("spring").with_sweep(ENGINE_STEPS[0], len(ENGINE_STEPS) - 1)
    reference = certified_reference(spring)
    runs = [
        measure(run_on_grid(spring, reference, method, dt, identity.precision), reference)
        for dt in spring.steps
    ]
    orders = {row["quantity"]: row["order"] for row in orders_of(runs, reference)}

    def energy(rate: int) -> float:
        steps = round(spring.duration * rate)
        run = simulate(spring, method, 1.0 / rate, steps=steps, precision=identity.precision)
        start = reference.observables.energy[0]
        extremes = np.array([run.low.energy.min(), run.high.energy.max()], float)
        return float(np.abs(extremes - start).max() / reference.scales.energy)

    return Examination(identity, orders["position"], orders["velocity"], energy(100), energy(60))


def print_examination(examined: Examination) -> None:
    """Print the answer, and the candidates from the nearest to the farthest."""
    found = examined.identity
    console = Console(width=None if os.isatty(1) else 120, highlight=False)
    print_line = functools.partial(console.print, markup=False, soft_wrap=True)
    print_line(f"{found.method} ({found.precision}): {found.integrator}")
    print_line(f"its velocity {found.velocity}")
    print_line(
        f"on the spring: observed order {number(examined.position_order)} in position, "
        f"{number(examined.velocity_order)} in velocity; energy off by up to "
        f"{number(100 * examined.energy_100)} % at 100 steps a second, "
        f"{number(100 * examined.energy_60)} % at 60"
    )
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("candidate")
    table.add_column("positions apart", justify="right")
    table.add_column("velocities apart", justify="right")
    for c in found.comparisons:
        table.add_row(CANDIDATES[c.candidate][0], number(c.position), number(c.velocity))
    console.print(table)
    print_line(
        f"in units of {found.precision}'s round-off as the motion magnifies it, largest over "
        f"{found.runs} runs of {STEPS} steps; up to {MATCH:g} is a match"
    )


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
