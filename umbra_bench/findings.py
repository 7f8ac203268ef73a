"""What the tables say, in words and in the tables of the page. Every number is read from results."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from typing import Any

import polars as pl

from umbra_bench import wording
from umbra_bench.methods import METHODS
from umbra_bench.scenario_tables import ScenarioTables, at_default_step, methods_of
from umbra_bench.wording import method_title, number

EXACT = 1e-9
"""A method whose error at the default step is below this part of the motion's size is exact."""

SECULAR = 0.5
"""Energy that drifts over the run by more than this part of its largest error is gained or lost."""


def order_text(
    tables: ScenarioTables, method: str, precision: str, quantity: str, decimals: int = 2
) -> str:
    """An observed order with its standard error, or why there is none."""
    row = tables.orders.filter(
        (pl.col("method") == method)
        & (pl.col("precision") == precision)
        & (pl.col("quantity") == quantity)
    )
    if row.is_empty():
        return "–"
    order, error = row.select("order", "standard_error").row(0)
    if math.isfinite(order):
        return wording.order_text(order, error, decimals)
    run = at_default_step(tables, method, precision)
    exact = run and run["position_error_max"] < EXACT * tables.reference["length_scale"]
    return "exact" if exact else "none"


def order_table(tables: Sequence[ScenarioTables]) -> dict[str, Any]:
    """Observed orders of position in each method's own precision: a column per scenario."""
    return {
        "columns": [t.scenario["name"] for t in tables],
        "rows": [
            (
                method_title(method),
                [
                    order_text(t, method, t.own_precision(method), "position")
                    if method in t.methods
                    else "–"
                    for t in tables
                ],
            )
            for method in methods_of(tables)
        ],
    }


def drift_table(tables: Sequence[ScenarioTables]) -> dict[str, Any]:
    """Energy drift per second at the default step in float64 and float32."""
    rows = []
    for method in methods_of(tables):
        for precision in ("float64", "float32"):
            found = [at_default_step(t, method, precision) for t in tables]
            if any(found):
                cells = [
                    "–"
                    if run is None
                    else f"diverged at {run['diverged_at']:g} s"
                    if run["diverged_at"] is not None
                    else f"{run['energy_drift_rate']:+.1e}"
                    for run in found
                ]
                rows.append((method_title(method), precision, cells))
    return {"columns": [t.scenario["name"] for t in tables], "rows": rows}


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


def paragraph(tables: Sequence[ScenarioTables], claims: dict[str, Any] | None = None) -> str:
    """The findings in plain words, with their numbers; only of what the results hold.

    `claims`: what `umbra-bench claims` found, where it was run.
    """
    sentences = [
        *claims_sentence(claims),
        *_order_sentence(tables),
        *_energy_sentence(tables),
        *_repair_sentence(tables),
        *_pymunk_sentence(tables),
    ]
    if sentences:
        return " ".join(sentences)
    if any("umbra" in t.methods for t in tables):
        return "The steps of this study are too few to show an order."
    return "The results hold no runs of UMBRA's methods."


def long_runs_caption(laws: Sequence[dict[str, Any]]) -> str:
    """Which errors of energy stay within bounds over the long runs, and how the others grow."""
    sentences = []
    for precision in ("float64", "float32"):
        rows = [row for row in laws if row["precision"] == precision]
        for law in dict.fromkeys(row["law"] for row in rows):
            alike = sorted(
                (row for row in rows if row["law"] == law), key=lambda row: row["energy_error_max"]
            )
            told = ", ".join(
                f"{method_title(row['method'])} ({number(row['energy_error_max'])}"
                + ("" if row["diverged_at"] is None else f", diverged at {row['diverged_at']:g} s")
                + (f", as t^{row['exponent']:.2f}" if law == "power" else "")
                + ")"
                for row in alike
            )
            sentences.append(f"{precision}, {_LAWS.get(law, law)}: {told}.")
    return " ".join(sentences)


_LAWS = {"none": "no law", "power": "another power of time"}


def claims_sentence(claims: dict[str, Any] | None) -> Iterable[str]:
    """How the devlog's statements fared, and those that fail, in their own words."""
    if claims is None:
        return
    rows = claims["statements"]
    measured = [row for row in rows if row["verdict"] != "waits"]
    failing = [row for row in rows if row["verdict"] == "fails"]
    named = ": " + "; ".join(f"“{row['statement'].rstrip('.')}”" for row in failing)
    yield (
        f"**Of {len(measured)} statements of UMBRA's devlog {len(failing)} fail when they are "
        f"measured** ([all of them](claims.md)){named if failing else ''}."
    )


def _order_sentence(tables: Sequence[ScenarioTables]) -> Iterable[str]:
    found = orders_of_position(tables, "umbra")
    if found:
        low, high = min(found.values()), max(found.values())
        yield (
            f"**UMBRA's integrator as published is of order {statistics.median(found.values()):.2f} "
            f"in position** (median over the {len(found)} scenarios that show an order, from "
            f"{low:.2f} to {high:.2f}); velocity Verlet, which its devlog names, "
            f"{_order_of('velocity-verlet', tables)}."
        )


def _energy_sentence(tables: Sequence[ScenarioTables]) -> Iterable[str]:
    spring = next((t for t in tables if t.scenario["name"] == "spring"), None)
    if spring is None:
        return
    runs = {
        m: at_default_step(spring, m, "float64")
        for m in ("umbra", "semi-implicit-euler", "velocity-verlet")
    }
    umbra, euler, verlet = (run and run["energy_error_max"] for run in runs.values())
    if umbra and euler and verlet:
        yield (
            f"On the spring at dt = {spring.default_step:g} s its energy is wrong by up to "
            f"{number(100 * umbra)} % of the energy scale: {number(umbra / euler)} times the error "
            f"of semi-implicit Euler ({number(100 * euler)} %), which it means to improve on, and "
            f"{number(umbra / verlet)} times that of velocity Verlet ({number(100 * verlet)} %)."
        )


def _repair_sentence(tables: Sequence[ScenarioTables]) -> Iterable[str]:
    found = orders_of_position(tables, "umbra-repaired")
    if found:
        second = sorted(name for name, order in found.items() if order > 1.5)
        first = sorted(name for name, order in found.items() if order <= 1.5)
        yield (
            "With its phases swapped and the first acceleration primed (`umbra-repaired`) the same "
            f"stages reach order {statistics.median(found[name] for name in second):.2f} on "
            f"{len(second)} scenarios"
            if second
            else "The repaired pipeline (`umbra-repaired`) reaches second order on no scenario"
        ) + (
            f"; where damping or forces that read the velocity act ({', '.join(first)}) it stays "
            "at first order."
            if first
            else "."
        )


def _pymunk_sentence(tables: Sequence[ScenarioTables]) -> Iterable[str]:
    spring = next((t for t in tables if t.scenario["name"] == "spring"), None)
    before = spring and at_default_step(spring, "pymunk", "float64")
    inside = spring and at_default_step(spring, "pymunk-velocity-func", "float64")
    if spring and before and inside:
        yield (
            f"pymunk with the force set before `step` is explicit Euler: its energy is off by "
            f"up to {number(100 * before['energy_error_max'])} % of the energy scale within "
            f"{spring.scenario['duration']:g} s on the same spring; "
            "with the force in the velocity callback its energy error stays below "
            f"{number(100 * inside['energy_error_max'])} %."
        )


def caption(figure: str, tables: ScenarioTables) -> str:
    """What a figure says, with the number."""
    name, step = tables.scenario["name"], tables.default_step
    umbra = at_default_step(tables, "umbra", "float64")
    verlet = at_default_step(tables, "velocity-verlet", "float64")
    if umbra is None or verlet is None:
        return f"`{name}`, all methods of the study."
    match figure:
        case "error":
            return (
                f"Observed order of position, float64: UMBRA as published "
                f"{order_text(tables, 'umbra', 'float64', 'position')}, repaired "
                f"{order_text(tables, 'umbra-repaired', 'float64', 'position')}, velocity Verlet "
                f"{order_text(tables, 'velocity-verlet', 'float64', 'position')}. At dt = {step:g} s "
                f"UMBRA is off by up to {number(umbra['position_error_max'])} m, velocity Verlet by "
                f"{number(verlet['position_error_max'])} m."
                f"{_outliers(tables, 'position_error_max', ' m')}"
            )
        case "energy-time":
            return (
                f"At dt = {step:g} s, float64, the energy of UMBRA as published is off by up to "
                f"{number(umbra['energy_error_max'])} of the energy scale "
                f"({_FATES[energy_fate(umbra, tables)]}), that of velocity Verlet by up to "
                f"{number(verlet['energy_error_max'])} ({_FATES[energy_fate(verlet, tables)]})."
            )
        case "energy":
            return (
                f"Largest energy error at dt = {step:g} s, float64: UMBRA as published "
                f"{number(umbra['energy_error_max'])}, velocity Verlet "
                f"{number(verlet['energy_error_max'])} of the energy scale "
                f"({number(tables.reference['energy_scale'])} J)."
                f"{_outliers(tables, 'energy_error_max')}"
            )
        case _:
            away = [
                method_title(method)
                for method in tables.methods
                if (run := at_default_step(tables, method, tables.own_precision(method)))
                and not run["position_error_max"] < 0.1 * tables.reference["length_scale"]
            ]
            leaving = (
                f"Off by more than a tenth of the motion's size at some time: {', '.join(away)}."
                if away
                else "No method is ever off by more than a tenth of the motion's size."
            )
            return (
                "The reference is the wide grey line beneath; marks at the ends show where each method "
                f"is at one and the same instant. {leaving}"
            )


_FATES = {
    "exact": "nothing but rounding",
    "bounded": "bounded",
    "gains": "it gains",
    "loses": "it loses",
    "diverged": "it diverges",
}


def _outliers(tables: ScenarioTables, column: str, unit: str = "") -> str:
    """Engines that are an order of magnitude apart from all other methods at a step, where most."""
    found: dict[str, tuple[float, dict[str, Any]]] = {}
    stayed = tables.runs.filter(pl.col("diverged_at").is_null() & (pl.col(column) > 0))
    for row in stayed.to_dicts():
        if row["method"] not in METHODS or METHODS[row["method"]].kind != "engine":
            continue
        others = tables.runs.filter(
            (pl.col("precision") == row["precision"])
            & (pl.col("dt") == row["dt"])
            & (pl.col("method") != row["method"])
            & (pl.col(column) > 0)
        )[column]
        if others.is_empty():
            continue
        apart = max(row[column] / others.max(), others.min() / row[column])
        if apart > max(10.0, found.get(row["method"], (0.0,))[0]):
            found[row["method"]] = apart, row
    told = [
        f"{method_title(method)} ({number(row[column])}{unit} at dt = {row['dt']:g} s)"
        for method, (_, row) in found.items()
    ]
    return f" Apart from all other methods by ten times or more: {', '.join(told)}." if told else ""


def orders_caption(tables: Sequence[ScenarioTables]) -> str:
    """What the figure of all orders says, with the numbers."""
    medians = [
        f"{method_title(method)} {statistics.median(found.values()):.2f} ({len(found)} scenarios)"
        for method in methods_of(tables)
        if (found := orders_of_position(tables, method, _precision_of(tables, method)))
    ]
    if not medians:
        return "No method shows an order."
    return (
        "Median of the observed orders of position, float64 or an engine's own precision: "
        f"{', '.join(medians)}."
    )


def orders_of_position(
    tables: Sequence[ScenarioTables], method: str, precision: str = "float64"
) -> dict[str, float]:
    """The observed orders of position, by scenario, where there is one."""
    table = pl.concat([t.orders for t in tables]).filter(
        (pl.col("method") == method)
        & (pl.col("precision") == precision)
        & (pl.col("quantity") == "position")
        & pl.col("order").is_finite()
    )
    return dict(zip(table["scenario"], table["order"], strict=True))


def _precision_of(tables: Sequence[ScenarioTables], method: str) -> str:
    return next(t.own_precision(method) for t in tables if method in t.methods)


def _order_of(method: str, tables: Sequence[ScenarioTables]) -> str:
    found = orders_of_position(tables, method)
    return f"is of order {statistics.median(found.values()):.2f}" if found else "shows no order"
