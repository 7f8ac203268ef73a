"""The sweep: scenario x method x precision x dt, to tables.

Every run is compared with the certified reference at the instants that the steps of a sweep share,
so that no interpolation enters; energy and momentum are also judged over every step in between
wherever the reference conserves them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from umbra_bench.errors import EngineFailed, UmbraBenchError, UnsupportedScenario
from umbra_bench.methods import METHODS, PRECISIONS, find_method, methods_of_study
from umbra_bench.metrics import (
    DIVERGENCE,
    FLOOR_FACTOR,
    SMALL_ERROR,
    ErrorPoint,
    drift_rate,
    observed_order,
    position_distance,
    velocity_distance,
)
from umbra_bench.parallel import map_in_processes
from umbra_bench.reference import Reference, certified_reference
from umbra_bench.scenario import Scenario
from umbra_bench.schemas import (
    ENERGY_SCHEMA,
    ORDERS_SCHEMA,
    QUANTITIES,
    REFERENCES_SCHEMA,
    SKIPS_SCHEMA,
    STUDY_SCHEMA,
)
from umbra_bench.simulation import Trajectory, simulate

ENGINE_STEPS = 2000
"""The most steps of one engine run: engines step in Python, and games step at 0.01 s."""

QUICK_HALVINGS = 3
"""The halvings of a quick study."""

MOTION_BODIES = 4
"""Of how many bodies the motion is kept for pictures."""


@dataclass(frozen=True)
class Study:
    """What a sweep found: tables, and the scenarios and references that they belong to.

    Attributes:
        runs: one row per scenario, method, precision and dt (`STUDY_SCHEMA`).
        orders: one row per scenario, method, precision and quantity (`ORDERS_SCHEMA`).
        references: one row per scenario: the certificate and the scales.
        skips: what was not run, with the reason.
        motion: positions and velocities at the default step, for pictures.
        energy: the energy error over time at the default step, for pictures.
    """

    scenarios: list[Scenario]
    runs: pl.DataFrame
    orders: pl.DataFrame
    references: pl.DataFrame
    skips: pl.DataFrame
    motion: pl.DataFrame
    energy: pl.DataFrame


@dataclass(frozen=True)
class _Job:
    """One line of a sweep: a method of one precision over all steps of a scenario."""

    scenario: Scenario
    reference: Reference
    method: str
    precision: str


@dataclass
class _Outcome:
    runs: list[dict[str, Any]]
    orders: list[dict[str, Any]]
    skips: list[dict[str, Any]]
    motion: list[pl.DataFrame]
    energy: list[pl.DataFrame]


Listener = Callable[[str, int, int], None]
"""Called with what was done, how many are done and how many there are."""


def run_study(
    scenarios: Sequence[Scenario],
    methods: Sequence[str] = (),
    precisions: Sequence[str] = PRECISIONS,
    *,
    quick: bool = False,
    processes: int | None = 1,
    listener: Listener = lambda what, done, total: None,
) -> Study:
    """Sweep methods over scenarios.

    Args:
        scenarios: from :func:`umbra_bench.load_scenario`.
        methods: names; none means all that a study runs unasked.
        precisions: of this project's integrators; an engine has its own.
        quick: only the first few steps of each sweep.
        processes: how many to use; None means one a core (see :mod:`umbra_bench.parallel`).
        listener: told of every finished scenario.

    Raises:
        UmbraBenchError: an unknown method, or a scenario whose reference cannot be had.
    """
    scenarios = _distinct(scenarios)
    precisions = list(dict.fromkeys(precisions))
    names = methods_of_study(methods)
    missing = [n for n, m in METHODS.items() if m.studied and not m.installed and not methods]
    if quick:
        scenarios = [
            s.with_sweep(s.dt.start, min(s.dt.halvings, QUICK_HALVINGS)) for s in scenarios
        ]
    lines = [
        (name, precision)
        for name in names
        for precision in (precisions if find_method(name).precision is None else ["its own"])
    ]
    parts = []
    for scenario, part in zip(
        scenarios,
        map_in_processes(_study_scenario, [(s, lines) for s in scenarios], processes),
        strict=True,
    ):
        parts.append(part)
        listener(scenario.name, len(parts), len(scenarios))
    tables = {
        name: pl.concat([getattr(part, name) for part in parts])
        for name in ("runs", "orders", "references", "skips", "motion", "energy")
    }
    absent = [
        {"scenario": "all", "method": name, "reason": METHODS[name].missing} for name in missing
    ]
    tables["skips"] = pl.concat([pl.DataFrame(absent, SKIPS_SCHEMA), tables["skips"]])
    return Study(scenarios, **tables)


def _distinct(scenarios: Sequence[Scenario]) -> list[Scenario]:
    """Each scenario once; two that differ under one name cannot be told apart in a table."""
    found: dict[str, Scenario] = {}
    for scenario in scenarios:
        if found.setdefault(scenario.name, scenario) != scenario:
            raise UmbraBenchError(f"two scenarios that differ are named {scenario.name!r}")
    if not found:
        raise UmbraBenchError("no scenario is named; see `umbra-bench list scenarios`")
    return list(found.values())


def _study_scenario(task: tuple[Scenario, list[tuple[str, str]]]) -> Study:
    """The study of one scenario: its reference first, then all lines of the sweep."""
    scenario, lines = task
    reference = certified_reference(scenario)
    outcomes = [_sweep(_Job(scenario, reference, *line)) for line in lines]
    return Study(
        scenarios=[scenario],
        runs=pl.DataFrame([row for o in outcomes for row in o.runs], STUDY_SCHEMA),
        orders=pl.DataFrame([row for o in outcomes for row in o.orders], ORDERS_SCHEMA),
        references=pl.DataFrame([_reference_row(scenario, reference)], REFERENCES_SCHEMA),
        skips=pl.DataFrame([row for o in outcomes for row in o.skips], SKIPS_SCHEMA),
        motion=pl.concat(
            [_reference_motion(scenario, reference), *(t for o in outcomes for t in o.motion)]
        ),
        energy=pl.concat(
            [pl.DataFrame(schema=ENERGY_SCHEMA), *(t for o in outcomes for t in o.energy)]
        ),
    )


def _sweep(job: _Job) -> _Outcome:
    """All steps of one line of the sweep, and its orders."""
    scenario, reference = job.scenario, job.reference
    outcome = _Outcome([], [], [], [], [])
    is_engine = find_method(job.method).kind == "engine"
    for dt in scenario.steps:
        if is_engine and round(scenario.duration / dt) > ENGINE_STEPS:
            continue
        try:
            trajectory = run_on_grid(scenario, reference, job.method, dt, job.precision)
        except (UnsupportedScenario, EngineFailed) as reason:
            outcome.skips.append(_skip(job, str(reason)))
            return outcome
        outcome.runs.append(measure(trajectory, reference))
        if dt == scenario.default_step:
            outcome.motion.append(_motion(trajectory, scenario))
            outcome.energy.append(_energy(trajectory, reference))
    if outcome.runs:
        outcome.orders += orders_of(outcome.runs, reference)
    else:
        outcome.skips.append(_skip(job, f"no step needs {ENGINE_STEPS} steps or fewer"))
    return outcome


def _skip(job: _Job, reason: str) -> dict[str, Any]:
    return {"scenario": job.scenario.name, "method": job.method, "reason": reason}


def run_on_grid(
    scenario: Scenario, reference: Reference, method: str, dt: float, precision: str
) -> Trajectory:
    """Run a method and sample it where the reference was, or at every step if that is coarser."""
    steps = round(scenario.duration / dt)
    return simulate(
        scenario,
        method,
        dt,
        steps=steps,
        every=max(1, steps // scenario.samples),
        precision=precision,
        energy_limit=DIVERGENCE * reference.scales.energy
        + float(abs(reference.observables.energy).max()),
    )


def measure(trajectory: Trajectory, reference: Reference) -> dict[str, Any]:
    """One row of the study: what a trajectory's errors are against the reference."""
    shared = slice(None, None, (len(reference.times) - 1) // (len(trajectory.times) - 1))
    with np.errstate(all="ignore"):  # overflow is a result: it stands in the row
        position = position_distance(
            trajectory.position, reference.position[shared], reference.radius
        )
        velocity = velocity_distance(
            trajectory.velocity, reference.velocity[shared], reference.radius
        )
        energy = energy_error(trajectory, reference)
        return {
            "scenario": trajectory.scenario,
            "method": trajectory.method,
            "precision": trajectory.precision,
            "dt": trajectory.dt,
            "steps": trajectory.steps,
            "position_error_max": float(position.max()),
            "velocity_error_max": float(velocity.max()),
            "position_error_final": float(position[-1]),
            "energy_error_max": _largest_error(trajectory, reference, "energy"),
            "energy_drift_rate": drift_rate(trajectory.times, energy),
            "angular_momentum_error_max": _largest_error(trajectory, reference, "angular_momentum"),
            "reference_error": reference.certificate.position,
            "diverged_at": trajectory.diverged_at,
            "wall_time": trajectory.wall_time,
        }


def energy_error(trajectory: Trajectory, reference: Reference) -> np.ndarray:
    """Energy of the method minus energy of the reference, over the energy scale, at the samples."""
    return _error(trajectory, reference, "energy")


def _error(trajectory: Trajectory, reference: Reference, name: str) -> np.ndarray:
    truth = getattr(reference.observables, name)
    shared = truth[:: (len(truth) - 1) // (len(trajectory.times) - 1)]
    values = getattr(trajectory.at, name).astype(float)
    return (values - shared) / getattr(reference.scales, name)


def _largest_error(trajectory: Trajectory, reference: Reference, name: str) -> float:
    """The largest relative error of an observable: over every step where physics conserves it."""
    errors = np.abs(_error(trajectory, reference, name))
    if reference.conserves(name):
        truth, scale = getattr(reference.observables, name)[0], getattr(reference.scales, name)
        for extremes in (trajectory.low, trajectory.high):
            streamed = np.abs(getattr(extremes, name).astype(float) - truth) / scale
            errors = np.concatenate([errors, streamed])
    return math.inf if np.isnan(errors).any() else float(errors.max())


def orders_of(runs: Sequence[dict[str, Any]], reference: Reference) -> list[dict[str, Any]]:
    """The observed order of each quantity over one line of a sweep."""
    scales = {"position": reference.scales.length, "velocity": reference.scales.speed}
    rows = []
    for quantity, column in QUANTITIES.items():
        floor = FLOOR_FACTOR * getattr(reference.certificate, quantity)
        ceiling = SMALL_ERROR * scales.get(quantity, 1.0)
        points = [
            ErrorPoint(
                run["dt"],
                run[column],
                run["diverged_at"] is None and floor <= run[column] <= ceiling,
            )
            for run in runs
        ]
        order = observed_order(points)
        line = {key: runs[0][key] for key in ("scenario", "method", "precision")}
        rows.append({**line, "quantity": quantity, **order._asdict()})
    return rows


def _motion(trajectory: Trajectory, scenario: Scenario) -> pl.DataFrame:
    return _motion_table(
        (trajectory.scenario, trajectory.method, trajectory.precision, trajectory.dt),
        trajectory.times,
        trajectory.position,
        trajectory.velocity,
        scenario,
    )


def _reference_motion(scenario: Scenario, reference: Reference) -> pl.DataFrame:
    line = (scenario.name, "reference", "float64", scenario.default_step)
    return _motion_table(line, reference.times, reference.position, reference.velocity, scenario)


def _motion_table(
    line: tuple[str, str, str, float],
    times: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    scenario: Scenario,
) -> pl.DataFrame:
    """A row per sample and body, of the first few bodies."""
    names = [body.name for body in scenario.bodies][:MOTION_BODIES]
    count = len(names)
    columns = {
        name: values[:, row, :count].astype(float).ravel()
        for values, names_ in ((position, ("x", "y", "angle")), (velocity, ("vx", "vy", "omega")))
        for row, name in enumerate(names_)
    }
    table = pl.DataFrame({"t": np.repeat(times, count), "body": names * len(times), **columns})
    return _labelled(table, line)


def _energy(trajectory: Trajectory, reference: Reference) -> pl.DataFrame:
    """The energy error over time: at the samples, and its extremes over the steps before each."""
    error = energy_error(trajectory, reference)
    low, high = error.copy(), error.copy()
    if reference.conserves("energy"):
        truth, scale = reference.observables.energy[0], reference.scales.energy
        with np.errstate(all="ignore"):
            low[1:] = np.fmin(low[1:], (trajectory.low.energy.astype(float) - truth) / scale)
            high[1:] = np.fmax(high[1:], (trajectory.high.energy.astype(float) - truth) / scale)
    table = pl.DataFrame(
        {"t": trajectory.times, "energy_error": error, "lowest": low, "highest": high}
    )
    line = (trajectory.scenario, trajectory.method, trajectory.precision, trajectory.dt)
    return _labelled(table, line)


def _labelled(table: pl.DataFrame, line: tuple[str, str, str, float]) -> pl.DataFrame:
    labels = zip(("scenario", "method", "precision", "dt"), line, strict=True)
    return table.select(*(pl.lit(value).alias(name) for name, value in labels), pl.all())


def _reference_row(scenario: Scenario, reference: Reference) -> dict[str, Any]:
    certificate = reference.certificate
    return {
        "scenario": scenario.name,
        "position_bound": certificate.position,
        "velocity_bound": certificate.velocity,
        "energy_bound": certificate.energy,
        "independent": certificate.independent,
        "independent_difference": certificate.independent_difference,
        "tolerance_difference": certificate.tolerance_difference,
        "energy_drift": certificate.energy_drift,
        "angular_momentum_drift": certificate.angular_momentum_drift,
        **{f"{name}_scale": value for name, value in reference.scales._asdict().items()},
    }
