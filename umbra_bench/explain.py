"""The history of one number: what was run, measured and fitted, told from results/ alone."""

from __future__ import annotations

import difflib
import math
import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from umbra_bench.errors import UmbraBenchError, hint, one_line
from umbra_bench.gate import METRICS, load_baseline
from umbra_bench.metrics import (
    FLOOR_FACTOR,
    ORDER_DROP,
    SMALL_ERROR,
    TOLERANCE,
    ErrorPoint,
    asymptotic_range,
)
from umbra_bench.results import RESULTS, load_environment, load_scenarios, load_table
from umbra_bench.schemas import DRIFT_LINE, DRIFT_SCHEMA, DRIFT_SERIES_SCHEMA, QUANTITIES
from umbra_bench.wording import number

WIDTH = 100
_SCALES = {"position": "length_scale", "velocity": "speed_scale"}
_UNITS = {"position": "m", "velocity": "m/s", "energy": "of the energy scale"}


class Cell(NamedTuple):
    """What a name of a cell means: a metric at one step, or the order of a quantity."""

    scenario: str
    method: str
    precision: str
    step: float | None
    metric: str

    def __str__(self) -> str:
        if self.step is None:
            return "/".join((*self[:3], self.metric, "order"))
        return "/".join((*self[:3], f"{self.step:g}", self.metric))


def reproduce(scenario: str, method: str | None = None, precision: str | None = None) -> str:
    """The command that measures a line of a study again; without a method, all lines of a scenario.

    For "reproduce: ..." beside a row or a figure of a page.
    """
    words = ["umbra-bench", "study", scenario]
    if method is not None:
        words += ["--method", method]
    if precision is not None:
        words += ["--precision", precision]
    return shlex.join(words)


def reproduce_run(cell: Cell, steps: int) -> str:
    """The command that writes the states of one run."""
    words = ["umbra-bench", "simulate", cell.scenario, "--method", cell.method]
    words += ["--dt", repr(cell.step), "--steps", str(steps), "--precision", cell.precision]
    return shlex.join(words)


def find_cell(name: str, runs: pl.DataFrame) -> Cell:
    """The cell of a study that a name means, as the gate and its table name it.

    `SCENARIO/METHOD/PRECISION/DT/METRIC`, or `SCENARIO/METHOD/PRECISION/QUANTITY/order`; the name of a
    method may hold slashes.

    Raises:
        UmbraBenchError: no cell has that name; the message tells the nearest.
    """
    cells = {str(cell): cell for cell in _cells(runs)}
    wanted = name.strip().replace(" order", "/order").replace(" ", "/")
    if wanted in cells:
        return cells[wanted]
    if not cells:
        raise UmbraBenchError("the study holds no runs, so no cell; run `umbra-bench study` again")
    near = {k: c for k, c in cells.items() if k.startswith(wanted.rstrip("/") + "/")}
    if not near:
        # A wrong word is told by the words in its place.
        near = _agreeing(wanted.split("/"), cells)
    nearest = difflib.get_close_matches(wanted, near or cells, n=6, cutoff=0.0)
    raise UmbraBenchError(
        one_line(f"CELL {name!r}: is no cell of the study{hint(wanted, nearest, 'the nearest')}")
    )


def _cells(runs: pl.DataFrame) -> Iterator[Cell]:
    keys = runs.select("scenario", "method", "precision", "dt")
    for scenario, method, precision, step in keys.iter_rows():
        for metric in METRICS:
            yield Cell(scenario, method, precision, step, metric)
    lines = runs.select("scenario", "method", "precision").unique(maintain_order=True)
    for scenario, method, precision in lines.iter_rows():
        for quantity in QUANTITIES:
            yield Cell(scenario, method, precision, None, quantity)


def _agreeing(words: Sequence[str], cells: dict[str, Cell]) -> dict[str, Cell]:
    """The cells that have the most of the words."""

    def agreement(name: str) -> int:
        return len(set(words) & set(name.split("/")))

    best = max(map(agreement, cells))
    return {name: cell for name, cell in cells.items() if agreement(name) == best} if best else {}


def explain(name: str, results: Path = RESULTS, baseline: Path | None = None) -> list[str]:
    """The history of a cell, in lines of at most 100 columns.

    `baseline`: by default `baseline.json` beside the results, if it is there.

    Raises:
        UmbraBenchError: results that are missing or cannot be read, or a cell that there is not.
    """
    if name.startswith("drift/"):
        history = _long_run_lines(name.removeprefix("drift/"), results)
        return [part for text in history for part in _folded(text)]
    runs, orders = load_table("study", results), load_table("orders", results)
    cell = find_cell(name, runs)
    line = pl.col("scenario").eq(cell.scenario) & pl.col("method").eq(cell.method)
    line &= pl.col("precision").eq(cell.precision)
    rows = runs.filter(line).sort("dt", descending=True).to_dicts()
    references = load_table("references", results).filter(pl.col("scenario") == cell.scenario)
    if references.is_empty():
        raise UmbraBenchError(
            f"{results / 'references.parquet'}: has no row of scenario {cell.scenario!r}; "
            "run `umbra-bench study` again"
        )
    (reference,) = references.to_dicts()
    told = [
        str(cell),
        *_scenario_lines(cell, results),
        *_reference_lines(reference),
    ]
    if cell.step is None:
        order = orders.filter(line & pl.col("quantity").eq(cell.metric)).to_dicts()
        told += _order_lines(cell, rows, reference, order)
    else:
        told += _run_lines(cell, rows)
    path = baseline or results / "baseline.json"
    if path.is_file() or baseline is not None:
        told += _baseline_lines(cell, load_baseline(path), path)
    told.append(f"reproduce: {reproduce(*cell[:3])}")
    told += [
        f"states: {reproduce_run(cell, row['steps'])}" for row in rows if row["dt"] == cell.step
    ]
    return [part for text in told for part in _folded(text)]


def _long_run_lines(name: str, results: Path) -> Iterator[str]:
    """The law of a long run, its samples, and the command that takes its steps again."""
    rows = {
        f"{row['scenario']}/{row['method']}/{row['precision']}/{row['dt']:g}": row
        for row in load_table("drift", results, DRIFT_SCHEMA).to_dicts()
    }
    if name not in rows:
        near = difflib.get_close_matches(name, rows, n=6, cutoff=0.0)
        raise UmbraBenchError(
            one_line(f"CELL 'drift/{name}': is no long run{hint(name, near, 'the nearest')}")
        )
    row = rows[name]
    line = pl.all_horizontal(pl.col(key).eq(row[key]) for key in DRIFT_LINE)
    series = load_table("drift_series", results, DRIFT_SERIES_SCHEMA).filter(line)
    yield f"drift/{name}: {row['steps']} steps of {row['dt']!r} s{_divergence(row)}"
    yield (
        f"law: {row['law']}, rate {row['rate']:.6g} 1/s, exponent {row['exponent']:.4g} ± "
        f"{row['standard_error']:.2g}; next likely: {row['runner_up']}, evidence {row['evidence']:.3g}"
    )
    yield "energy error in parts of the energy scale: at the step, least and most since the last one"
    for sample in series.to_dicts():
        error, low, high = (sample[key] for key in ("energy_error", "lowest", "highest"))
        yield f"  step {sample['step']:<12d} {error:+.6e}  {low:+.6e}  {high:+.6e}"
    words = ["umbra-bench", "drift", row["scenario"], "--method", row["method"], "--precision"]
    words += [row["precision"], "--dt", repr(row["dt"]), "--steps", str(row["steps"]), "--restart"]
    yield f"reproduce: {shlex.join(words)}"


def _scenario_lines(cell: Cell, results: Path) -> Iterator[str]:
    described, hashes = load_scenarios(results), load_environment(results)["scenarios"]
    document = described.get(cell.scenario)
    if document is None:
        raise UmbraBenchError(
            f"{results / 'scenarios.json'}: does not describe scenario {cell.scenario!r}; "
            "run `umbra-bench study` again"
        )
    yield f"scenario: {cell.scenario}, {document['title']}: scenarios/{cell.scenario}.toml"
    yield f"  SHA-256 of what it states: {hashes.get(cell.scenario, 'not recorded')}"
    count = len(document["bodies"])
    yield (
        f"  {count} bod{'y' if count == 1 else 'ies'}, {document['duration']:g} s, steps from "
        f"{document['dt']['start']:g} s by {document['dt']['halvings']} halvings"
    )
    step = "" if cell.step is None else f", dt = {cell.step!r} s"
    yield f"method: {cell.method}, {cell.precision}{step}"


def _reference_lines(reference: dict[str, Any]) -> Iterator[str]:
    bounds = ", ".join(
        f"{quantity} {number(reference[f'{quantity}_bound'])} {_UNITS[quantity]}"
        for quantity in QUANTITIES
    )
    yield f"reference: Dopri8, float64; wrong by at most: {bounds}"
    yield (
        f"  compared with {reference['independent']}: off by "
        f"{number(reference['independent_difference'])} of the length scale; "
        f"at another tolerance: {number(reference['tolerance_difference'])}"
    )


def _run_lines(cell: Cell, rows: Iterable[dict[str, Any]]) -> Iterator[str]:
    yield f"{cell.metric} at each step of the sweep:"
    for row in rows:
        here = " <- this cell" if row["dt"] == cell.step else ""
        yield f"  dt = {row['dt']:<12g} {row[cell.metric]!r}{_divergence(row)}{here}"


def _divergence(row: dict[str, Any]) -> str:
    return "" if row["diverged_at"] is None else f", diverged at {row['diverged_at']:g} s"


def _order_lines(
    cell: Cell,
    rows: Sequence[dict[str, Any]],
    reference: dict[str, Any],
    orders: Sequence[dict[str, Any]],
) -> Iterator[str]:
    column = QUANTITIES[cell.metric]
    floor = FLOOR_FACTOR * reference[f"{cell.metric}_bound"]
    ceiling = SMALL_ERROR * (reference[_SCALES[cell.metric]] if cell.metric in _SCALES else 1.0)
    reasons = {row["dt"]: _unusable(row, column, floor, ceiling) for row in rows}
    points = [ErrorPoint(row["dt"], row[column], reasons[row["dt"]] is None) for row in rows]
    fitted = {point.dt for point in asymptotic_range(points)}
    yield (
        f"{column} at each step; floor {number(floor)} ({FLOOR_FACTOR:g} bounds), "
        f"ceiling {number(ceiling)} ({SMALL_ERROR:g} of the scale):"
    )
    for row in rows:
        why = reasons[row["dt"]]
        used = "in the fit" if row["dt"] in fitted else why or "outside the asymptotic range"
        yield f"  dt = {row['dt']:<12g} {row[column]!r:24} {used}"
    for row in orders:
        if math.isfinite(row["order"]):
            yield (
                f"order: {row['order']:.6g} ± {row['standard_error']:.2g} (standard error), the slope of "
                f"log(error) over {row['points']} steps"
            )
        else:
            yield f"order: none; {row['points']} steps above the floor show no asymptotic range"


def _unusable(row: dict[str, Any], column: str, floor: float, ceiling: float) -> str | None:
    """Why no order is read from a run, if none is."""
    if row["diverged_at"] is not None:
        return f"diverged at {row['diverged_at']:g} s"
    if not math.isfinite(row[column]):
        return "not finite"
    if row[column] < floor:
        return "at the floor of the reference"
    if row[column] > ceiling:
        return "above the ceiling: not small"
    return None


def _baseline_lines(cell: Cell, baseline: dict[str, Any], path: Path) -> Iterator[str]:
    if cell.step is None:
        known = baseline["orders"].get("/".join(cell[:3]), {}).get(cell.metric)
        rule = f"may fall by {ORDER_DROP:g}; the gate's slope, over its own steps"
    else:
        key = f"{'/'.join(cell[:3])}/{cell.step:g}"
        known = baseline["cells"].get(key, {}).get(cell.metric)
        rule = f"may grow by {100 * TOLERANCE:g} %, and by the round-off floor"
    if known is None:
        yield f"baseline: {path} has no such number"
    else:
        yield f"baseline: {known!r} in {path}: {rule}"


def _folded(text: str) -> Iterator[str]:
    """A line of at most `WIDTH` columns and its continuations, broken between words where it can."""
    indent = ""
    while len(indent + text) > WIDTH:
        room = WIDTH - len(indent)
        cut = text.rfind(" ", len(text) - len(text.lstrip()) + 1, room + 1)
        cut = cut if cut > 0 else room
        yield indent + text[:cut]
        text, indent = text[cut:].lstrip(), "    "
    yield indent + text
