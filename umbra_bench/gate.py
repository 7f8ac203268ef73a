"""The regression gate: did the last change make an integrator worse?

A small fixed plan of cells (scenario, method, precision, step) is run, measured against the certified
reference, and judged against a committed baseline. Two things are judged:

- **methods**: an error that grew beyond the tolerance, an order that dropped, a run that diverges. An
  error at the round-off floor is judged against the floor, since another processor rounds otherwise.
- **the truth**: the reference's own states. Where the force laws or the bodies change, every method
  moves with them and no error shows; but the reference moves too, and that is always a failure.

What each scenario of the plan is sensitive to:

=================  ===============================================================================
`spring`           every coefficient of every method (linear: the errors are exact multiples)
`spring_damped`    damping per second, its order among the stages
`spring_dashpot`   how each method treats a force that depends on the velocity
`orbit_eccentric`  evaluation points of the forces (nonlinear), angular momentum, order 4
`crane`            every other force law, points, couplings, kinematic and static bodies, inertia;
                   through `umbra-service` every call of the game's door
`free_fall_damped` gravity as a force for unequal masses, its flag, damping of each body
`spinning_box`     wrapping of angles, rotation in both senses, inertia of both shapes
=================  ===============================================================================
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from umbra_bench.errors import UmbraBenchError, UnsupportedScenario, hint, one_line, short
from umbra_bench.methods import METHODS, PRECISIONS, find_method
from umbra_bench.metrics import ORDER_DROP, TOLERANCE
from umbra_bench.parallel import map_in_processes
from umbra_bench.reference import Reference, certified_reference
from umbra_bench.results import RESULTS, load_json, save_json
from umbra_bench.scenario import Scenario, list_scenarios, load_scenario, scenario_hash
from umbra_bench.schemas import QUANTITIES
from umbra_bench.study import measure, run_on_grid

BASELINE = RESULTS / "baseline.json"
FORMAT = "umbra-bench baseline 1"

TRUTH_TOLERANCE = 1e-8
"""The reference may move by this part of the motion's size: rounding, far below any change of law."""

FINGERPRINT_SAMPLES = 4
"""At how many instants, the end among them, the reference's states are kept in the baseline."""

METRICS = (
    "energy_error_max",
    "energy_drift_rate",
    "position_error_max",
    "velocity_error_max",
    "angular_momentum_error_max",
)

TEXTBOOK = tuple(n for n, m in METHODS.items() if m.kind == "integrator")
UMBRA = ("umbra", "umbra-repaired")
DOUBLE = ("float64",)

PLAN: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("crane", ("umbra", "umbra-service"), PRECISIONS),
    ("crane", ("umbra-repaired",), DOUBLE),
    ("spring", (*TEXTBOOK, *UMBRA), PRECISIONS),
    ("spring", ("pymunk", "pymunk-velocity-func", "pymunk-spring"), DOUBLE),
    ("spring_damped", TEXTBOOK, DOUBLE),
    ("spring_damped", (*UMBRA, "umbra-service"), PRECISIONS),
    ("spring_dashpot", TEXTBOOK, DOUBLE),
    ("spring_dashpot", UMBRA, PRECISIONS),
    ("orbit_eccentric", (*TEXTBOOK, *UMBRA), PRECISIONS),
    ("free_fall_damped", UMBRA, PRECISIONS),
    ("spinning_box", ("semi-implicit-euler",), DOUBLE),
    ("spinning_box", UMBRA, PRECISIONS),
)
"""The gate's scenarios, the methods that it runs there, and in which precisions: an engine keeps its
own. The textbook's methods share the loop and the forces with UMBRA's, so that float32 of them on a
linear and on a nonlinear scenario shows what float32 can do."""

Verdict = Literal["pass", "better", "fail", "unjudged"]


class Judgement(NamedTuple):
    """One number against its baseline.

    Attributes:
        cell: scenario/method/precision/dt, or scenario/method/precision for an order.
        metric: what was judged.
        baseline, now: the two numbers; None where there is none.
        allowed: the limit that decided.
        note: why, in words.
    """

    cell: str
    metric: str
    baseline: float | None
    now: float | None
    allowed: float | None
    verdict: Verdict
    note: str = ""

    @property
    def factor(self) -> float | None:
        """How many times the baseline the number is now."""
        if self.baseline is None or self.now is None or self.baseline == 0.0:
            return None
        return self.now / self.baseline


class Line(NamedTuple):
    """A method of one precision on one scenario: what the gate runs."""

    scenario: str
    method: str
    precision: str

    def __str__(self) -> str:
        return "/".join(self)


@dataclass
class Measurement:
    """What the gate measured, in the form of the baseline.

    Attributes:
        hashes: what each scenario states.
        truths: per scenario, names and values of the reference's states.
        scales: per scenario and name of `truths`, the size that a change of it is relative to.
        cells: per cell, its metrics.
        orders: per line and quantity, the slope of its error over the gate's steps.
        floors: per cell and metric, the round-off floor (not kept in the baseline).
        budgets: absolute limits of the scenario files, per cell and metric.
        refused: per line that a method could not run, its reason.
    """

    hashes: dict[str, str] = field(default_factory=dict)
    truths: dict[str, dict[str, float]] = field(default_factory=dict)
    scales: dict[str, dict[str, float]] = field(default_factory=dict)
    cells: dict[str, dict[str, float | None]] = field(default_factory=dict)
    orders: dict[str, dict[str, float]] = field(default_factory=dict)
    floors: dict[str, dict[str, float]] = field(default_factory=dict)
    budgets: dict[str, dict[str, float]] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def planned_lines(scenarios: Iterable[Scenario] = ()) -> list[Line]:
    """The lines of the plan, and those that budgets of other `scenarios` ask for."""
    lines = [
        Line(scenario, method, precision)
        for scenario, methods, precisions in PLAN
        for method in methods
        for precision in _precisions(method, precisions)
    ]
    lines += [
        line
        for scenario in scenarios
        for method in scenario.budget
        if method in METHODS
        for precision in _precisions(method, PRECISIONS)
        if (line := Line(scenario.name, method, precision)) not in lines
    ]
    return lines


ENGINE_SCENARIOS = (
    "spring",
    "elastic_pendulum",
    "orbit_eccentric",
    "torsion_spring",
    "spring_damped",
)
"""Where an engine that the reader brings is judged: linear, nonlinear, turning, damped."""


def lines_of(methods: Iterable[str]) -> list[Line]:
    """The lines of a gate for methods of the reader's choice.

    Raises:
        UmbraBenchError: a method that is unknown, does not answer or takes no steps.
    """
    methods = list(dict.fromkeys(methods))
    for method in methods:
        if find_method(method).kind == "reference":
            raise UmbraBenchError(f"--method {method!r}: it is what the others are judged against")
    return [
        Line(scenario, method, precision)
        for scenario in ENGINE_SCENARIOS
        for method in methods
        for precision in _precisions(method, PRECISIONS)
    ]


def _precisions(method: str, precisions: Sequence[str]) -> Sequence[str]:
    own = find_method(method).precision
    return precisions if own is None else (own,)


def gate_steps(scenario: Scenario) -> list[float]:
    """The steps that the gate runs: twice the default step, the default and half of it."""
    default = scenario.default_step
    return [dt for dt in scenario.steps if 0.4 < dt / default < 2.5]


def measure_lines(
    lines: Sequence[Line],
    listener: Callable[[str, int, int], None] = lambda what, done, total: None,
    references: Mapping[str, Reference] | None = None,
    processes: int | None = 1,
) -> Measurement:
    """Run lines of the gate and measure them, against `references` where these are given.

    `processes` is as in :func:`umbra_bench.study.run_study`.

    Raises:
        UmbraBenchError: a scenario that cannot be read or has no reference.
    """
    by_scenario: dict[str, list[Line]] = {}
    for line in lines:
        by_scenario.setdefault(line.scenario, []).append(line)
    tasks = [
        (load_scenario(name), members, references[name] if references is not None else None)
        for name, members in by_scenario.items()
    ]
    measurement = Measurement()
    for done, part in enumerate(map_in_processes(_measure_scenario, tasks, processes), start=1):
        for name, table in vars(part).items():
            getattr(measurement, name).update(table)
        listener(tasks[done - 1][0].name, done, len(tasks))
    return measurement


def measure_truth(name: str) -> tuple[Measurement, Reference]:
    """The reference of a scenario alone, and what the gate keeps of it.

    Raises:
        UmbraBenchError: as :func:`measure_lines`.
    """
    scenario = load_scenario(name)
    reference = certified_reference(scenario)
    return _measure_scenario((scenario, [], reference)), reference


def _measure_scenario(task: tuple[Scenario, list[Line], Reference | None]) -> Measurement:
    scenario, lines, reference = task
    if reference is None:
        reference = certified_reference(scenario)
    measurement = Measurement()
    _measure_truth(measurement, scenario, reference)
    for line in lines:
        try:
            rows = [
                measure(
                    run_on_grid(scenario, reference, line.method, dt, line.precision), reference
                )
                for dt in gate_steps(scenario)
            ]
        except UnsupportedScenario as reason:
            measurement.refused[str(line)] = str(reason)
            continue
        _measure_line(measurement, scenario, reference, line, rows)
    return measurement


def _measure_truth(measurement: Measurement, scenario: Scenario, reference: Reference) -> None:
    """The fingerprint of the truth: states and energies of the reference at some instants."""
    truth: dict[str, float] = {}
    sizes: dict[str, float] = {}
    scales = reference.scales
    count = len(reference.times) - 1
    for k in range(1, FINGERPRINT_SAMPLES + 1):
        n = count * k // FINGERPRINT_SAMPLES
        instant = f"t={reference.times[n]:g}"
        for i, body in enumerate(scenario.bodies[:8]):
            for row, (x, v) in enumerate((("x", "vx"), ("y", "vy"), ("angle", "omega"))):
                turn = max(float(np.abs(reference.position[:, 2]).max()), 1.0)
                spin = max(float(np.abs(reference.velocity[:, 2]).max()), 1.0)
                truth[f"{instant} {body.name}.{x}"] = float(reference.position[n, row, i])
                sizes[f"{instant} {body.name}.{x}"] = scales.length if row < 2 else turn
                truth[f"{instant} {body.name}.{v}"] = float(reference.velocity[n, row, i])
                sizes[f"{instant} {body.name}.{v}"] = scales.speed if row < 2 else spin
        truth[f"{instant} energy"] = float(reference.observables.energy[n])
        sizes[f"{instant} energy"] = max(scales.energy, abs(truth[f"{instant} energy"]))
        truth[f"{instant} angular momentum"] = float(reference.observables.angular_momentum[n])
        sizes[f"{instant} angular momentum"] = scales.angular_momentum
    certificate = reference.certificate
    truth["distance from " + certificate.independent] = certificate.independent_difference
    sizes["distance from " + certificate.independent] = 1.0
    measurement.hashes[scenario.name] = scenario_hash(scenario)
    measurement.truths[scenario.name], measurement.scales[scenario.name] = truth, sizes


def _measure_line(
    measurement: Measurement,
    scenario: Scenario,
    reference: Reference,
    line: Line,
    rows: list[dict[str, Any]],
) -> None:
    budget = scenario.budget.get(line.method)
    for row in rows:
        cell = f"{line}/{row['dt']:g}"
        metrics: dict[str, float | None] = {name: abs(row[name]) for name in METRICS}
        metrics["diverged_at"] = row["diverged_at"]
        measurement.cells[cell] = metrics
        measurement.floors[cell] = _floors(reference, row)
        if budget is not None and row["dt"] == scenario.default_step:
            limits = budget.model_dump(exclude_none=True)
            measurement.budgets[cell] = limits
    slopes = {}
    for quantity in ("position", "velocity", "energy"):
        column = f"{quantity}_error_max"
        errors = [row[column] for row in rows]
        above = all(
            math.isfinite(row[column])
            and row[column] > 10 * _floors(reference, row)[column]
            and row["diverged_at"] is None
            for row in rows
        )
        if above and len(rows) > 1:
            slopes[quantity] = float(
                np.polyfit(np.log([row["dt"] for row in rows]), np.log(errors), 1)[0]
            )
    measurement.orders[str(line)] = slopes


def _floors(reference: Reference, row: dict[str, Any]) -> dict[str, float]:
    """What rounding alone can do to each metric: an ulp of the largest value in every step."""
    scales, observables = reference.scales, reference.observables
    ulps = float(np.finfo(row["precision"]).eps) * row["steps"]
    place = float(np.abs(reference.position[:, :2]).max())
    turn = float((np.abs(reference.position[:, 2]) % (2 * math.pi) * reference.radius).max())
    position = ulps * max(scales.length, place, turn)
    velocity = ulps * scales.speed
    energy = ulps * max(1.0, float(np.abs(observables.energy).max()) / scales.energy)
    momentum = ulps * max(1.0, place * scales.speed / scales.angular_momentum)
    certificate = reference.certificate
    return {
        "position_error_max": position + 10 * certificate.position,
        "velocity_error_max": velocity + 10 * certificate.velocity,
        "energy_error_max": energy + 10 * certificate.energy,
        "energy_drift_rate": (energy + 10 * certificate.energy) / float(reference.times[-1]),
        "angular_momentum_error_max": momentum,
    }


# Judging ------------------------------------------------------------------------------------------


def judge(now: Measurement, baseline: dict[str, Any], *, whole: bool = False) -> list[Judgement]:
    """Every number that was measured against the baseline; what cannot be judged says so.

    `whole`: all that the baseline holds should have been measured; what was not is unjudged too.
    """
    found: list[Judgement] = []
    if whole:
        found += [
            Judgement(cell, "cell", None, None, None, "unjudged", "in the baseline, not measured")
            for table, measured in (("scenarios", now.hashes), ("cells", now.cells))
            for cell in baseline[table]
            if cell not in measured
        ]
    for name, value in now.hashes.items():
        if baseline["scenarios"].get(name) != value:
            known = name in baseline["scenarios"]
            note = "the scenario file changed" if known else "not in the baseline"
            found.append(Judgement(name, "scenario", None, None, None, "unjudged", note))
    changed = {judgement.cell for judgement in found}
    for name, truth in now.truths.items():
        if name not in changed:
            found += _judge_truth(name, truth, baseline["truths"].get(name, {}), now.scales[name])
    for cell, metrics in now.cells.items():
        if cell.split("/")[0] not in changed:
            found += _judge_cell(cell, metrics, baseline["cells"].get(cell), now.floors[cell])
    for line, orders in now.orders.items():
        if line.split("/")[0] not in changed:
            found += _judge_orders(line, orders, baseline["orders"].get(line))
    for cell, limits in now.budgets.items():
        found += _judge_budget(cell, limits, now.cells[cell])
    return found


def _judge_truth(
    name: str, truth: dict[str, float], known: dict[str, float], sizes: dict[str, float]
) -> Iterator[Judgement]:
    cell = f"{name}/reference"
    for key, value in truth.items():
        if key not in known:
            yield Judgement(cell, key, None, value, None, "unjudged", "missing in the baseline")
            continue
        change, allowed = abs(value - known[key]), TRUTH_TOLERANCE * sizes[key]
        verdict: Verdict = "pass" if change <= allowed else "fail"
        note = "" if verdict == "pass" else "the truth moved: a force law, a body or the solver"
        yield Judgement(cell, key, known[key], value, allowed, verdict, note)


def _judge_cell(
    cell: str,
    metrics: dict[str, float | None],
    known: dict[str, float | None] | None,
    floors: dict[str, float],
) -> Iterator[Judgement]:
    if known is None:
        yield Judgement(cell, "cell", None, None, None, "unjudged", "missing in the baseline")
        return
    yield from _judge_divergence(cell, metrics["diverged_at"], known)
    for name in METRICS:
        value = metrics[name]
        if name not in known:
            yield Judgement(cell, name, None, value, None, "unjudged", "missing in the baseline")
            continue
        before = known[name]
        if before is None and value is not None and metrics["diverged_at"] is None:
            yield Judgement(cell, name, before, value, None, "better", "run gate --update")
            continue
        if before is None or value is None or not math.isfinite(value):
            diverged = metrics["diverged_at"] is not None and known.get("diverged_at") is not None
            verdict: Verdict = "pass" if diverged else "fail"
            yield Judgement(cell, name, before, value, None, verdict, "not finite")
            continue
        floor = floors[name]
        allowed = before * (1 + TOLERANCE) + floor
        if not value <= allowed:
            yield Judgement(cell, name, before, value, allowed, "fail", "worse")
        elif value < before * (1 - TOLERANCE) - floor:
            yield Judgement(cell, name, before, value, allowed, "better", "run gate --update")
        else:
            yield Judgement(cell, name, before, value, allowed, "pass")


def _judge_divergence(
    cell: str, now: float | None, known: dict[str, float | None]
) -> Iterator[Judgement]:
    if "diverged_at" not in known:
        yield Judgement(cell, "diverged_at", None, now, None, "unjudged", "missing in the baseline")
        return
    before = known["diverged_at"]
    if now is not None and (before is None or now < before * (1 - TOLERANCE)):
        yield Judgement(cell, "diverged_at", before, now, before, "fail", "diverges")
    elif before is not None and now is None:
        yield Judgement(cell, "diverged_at", before, now, before, "better", "run gate --update")
    else:
        yield Judgement(cell, "diverged_at", before, now, before, "pass")


def _judge_orders(
    line: str, orders: dict[str, float], known: dict[str, float] | None
) -> Iterator[Judgement]:
    if known is None:
        yield Judgement(line, "orders", None, None, None, "unjudged", "missing in the baseline")
        return
    for quantity in sorted({*orders, *known}):
        name, before, value = f"{quantity} order", known.get(quantity), orders.get(quantity)
        if before is None:
            # Errors rose above the floor; whether that is worse, their own cells tell.
            continue
        allowed = before - ORDER_DROP
        if value is None or value >= allowed:
            # Without a slope the errors are at the floor or not finite: their cells judge them.
            yield Judgement(line, name, before, value, allowed, "pass")
        else:
            yield Judgement(line, name, before, value, allowed, "fail", "the order dropped")


def _judge_budget(
    cell: str, limits: dict[str, float], metrics: dict[str, float | None]
) -> Iterator[Judgement]:
    for name, limit in limits.items():
        value = metrics[name]
        good = value is not None and value <= limit
        note = "" if good else "above the scenario's budget"
        verdict: Verdict = "pass" if good else "fail"
        yield Judgement(cell, f"budget {name}", limit, value, limit, verdict, note)


def exit_code(judgements: Iterable[Judgement]) -> int:
    """0 all good, 1 something is worse, 2 something could not be judged."""
    verdicts = {judgement.verdict for judgement in judgements}
    return 1 if "fail" in verdicts else 2 if "unjudged" in verdicts else 0


# The baseline -------------------------------------------------------------------------------------

_TABLES = ("format", "scenarios", "truths", "cells", "orders")


def load_baseline(path: Path) -> dict[str, Any]:
    """Read a baseline and check that it is one.

    Raises:
        UmbraBenchError: it is missing, truncated, of another kind, or holds what is no number.
    """
    if not path.is_file():
        raise UmbraBenchError(
            f"{path}: there is no baseline; `umbra-bench gate --update` makes one"
        )
    baseline = load_json(path)
    if not isinstance(baseline, dict) or baseline.get("format") != FORMAT:
        raise UmbraBenchError(f"{path}: not a baseline of this gate; expected format = {FORMAT!r}")
    for key in _TABLES[1:]:
        if not isinstance(baseline.get(key), dict):
            raise UmbraBenchError(f"{path}: {key}: missing; expected a table")
    unknown = next((key for key in baseline if key not in _TABLES), None)
    if unknown is not None:
        raise UmbraBenchError(
            one_line(f"{path}: {short(unknown)}: unknown key{hint(unknown, _TABLES)}")
        )
    for key in _TABLES[1:]:
        for name, entry in baseline[key].items():
            for metric, complaint in _complaints(key, entry):
                raise UmbraBenchError(one_line(f"{path}: {key}[{name!r}]{metric}{complaint}"))
    return baseline


def _complaints(table: str, entry: Any) -> Iterator[tuple[str, str]]:
    """What is wrong with an entry of one of the baseline's tables: where in it, and what."""
    if table == "scenarios":
        if not (isinstance(entry, str) and re.fullmatch("[0-9a-f]{64}", entry)):
            yield "", f" = {short(entry)}: expected a SHA-256, 64 hexadecimal digits"
        return
    if not isinstance(entry, dict):
        yield "", ": expected a table of numbers"
        return
    for metric, value in entry.items():
        absent = value is None and table == "cells"
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not absent and not (number and abs(value) <= sys.float_info.max):
            yield f".{metric}", f" = {short(value)}: expected a finite number"
        if table == "cells" and not absent and value < 0.0:
            yield f".{metric}", f" = {short(value)}: expected a number >= 0"
    known = {"cells": (*METRICS, "diverged_at"), "orders": tuple(QUANTITIES)}.get(table)
    for metric in entry:
        if known is not None and metric not in known:
            yield f".{metric}", f": unknown key{hint(metric, known)}"


def as_baseline(measurement: Measurement) -> dict[str, Any]:
    """A measurement as a baseline: rounded, so that its diff reads well in review."""
    return {
        "format": FORMAT,
        "scenarios": measurement.hashes,
        "truths": {
            name: {key: _rounded(value, 12) for key, value in truth.items()}
            for name, truth in measurement.truths.items()
        },
        "cells": {
            cell: {
                name: None if value is None or not math.isfinite(value) else _rounded(value, 4)
                for name, value in metrics.items()
            }
            for cell, metrics in measurement.cells.items()
        },
        "orders": {
            line: {quantity: round(order, 3) for quantity, order in orders.items()}
            for line, orders in measurement.orders.items()
        },
    }


def save_baseline(measurement: Measurement, path: Path) -> None:
    """Write a baseline."""
    save_json(as_baseline(measurement), path)


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits - 1}e}")


def budgeted_scenarios() -> list[Scenario]:
    """The scenarios whose files hold budgets."""
    loaded = (load_scenario(name) for name in list_scenarios())
    return [scenario for scenario in loaded if scenario.budget]
