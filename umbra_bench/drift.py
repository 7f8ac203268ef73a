"""Long runs: the energy error over as many steps as one has patience for, interrupted or not.

A run is followed at steps that are spaced logarithmically and depend on nothing but their number; what
happens between two of them is streamed by the compiled loop. Memory does not grow with the steps.
Where it stands is kept every few seconds, exactly: a run that goes on is the run that was never
interrupted, bit for bit.
"""

from __future__ import annotations

import io
import json
import math
import time
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from umbra_bench.compiled import COMPILED_METHODS, CompiledRun
from umbra_bench.drift_law import fit_drift_law
from umbra_bench.errors import UmbraBenchError, hint, one_line
from umbra_bench.methods import METHODS
from umbra_bench.metrics import DIVERGENCE
from umbra_bench.reference import Reference, certified_reference
from umbra_bench.results import (
    alone_at,
    is_there,
    load_table,
    read_sealed,
    replacing,
    together,
    write_table,
)
from umbra_bench.scenario import Scenario, scenario_hash
from umbra_bench.schemas import DRIFT_LINE, DRIFT_SCHEMA, DRIFT_SERIES_SCHEMA
from umbra_bench.simulation import open_run
from umbra_bench.system import build_system

PER_DECADE = 12
MOST_STEPS = 2**53
KEEP_SECONDS = 10.0
SLICE_SECONDS = 0.5
"""The loop returns so often, to say how far it is and to be interrupted."""

Listener = Callable[[str, int, int], None]


def run_drift(
    scenario: Scenario,
    methods: Sequence[str],
    precisions: Sequence[str],
    steps: int,
    dt: float | None,
    results: Path,
    *,
    restart: bool = False,
    listener: Listener = lambda what, done, total: None,
) -> pl.DataFrame:
    """Follow methods over `steps` steps; write drift.csv, drift.parquet and drift_series.parquet.

    Args:
        scenario: one that conserves energy.
        methods: compiled ones; none means all that a study runs unasked.
        precisions: "float32", "float64".
        dt: s; None means the scenario's default step.
        results: where the tables and, in drift/, what is kept of unfinished runs lie.
        restart: begin anew.
        listener: told what runs, and how many steps of all are done.

    Returns:
        The rows of `drift` (`DRIFT_SCHEMA`) of these runs.

    Raises:
        UmbraBenchError: a method that is none, a scenario without a conserved energy, a kept state
            that is damaged or belongs to something else, another command that follows the same run.
    """
    names = [m for m in COMPILED_METHODS if METHODS[m].studied] if not methods else list(methods)
    for name in names:
        if name not in COMPILED_METHODS:
            raise UmbraBenchError(
                f"--method {name!r}: cannot be followed over so many steps"
                f"{hint(name, COMPILED_METHODS)}"
            )
    reference = certified_reference(scenario)
    if not reference.conserves("energy"):
        raise UmbraBenchError(
            f"scenario {scenario.name}: its energy is not conserved, so there is no drift to follow; "
            "see `umbra-bench study` for its errors"
        )
    dt = scenario.default_step if dt is None else dt
    lines = [(name, precision) for name in names for precision in dict.fromkeys(precisions)]
    rows = []
    for place, (method, precision) in enumerate(lines):

        def told(what: str, done: int, before: int = place * steps) -> None:
            listener(what, before + done, len(lines) * steps)

        run = _LongRun(scenario, reference, method, precision, dt, results / "drift")
        with alone_at(run.place):
            run.take_up(restart)
            run.go_on(steps, told)
            series, row = run.tables()
            _merge(series, row, results)
        rows.append(row)
    return pl.concat(rows)


def sample_steps(steps: int) -> list[int]:
    """The steps at which runs are looked at, up to `steps`: twelve a decade, the same for every run."""
    decades = math.ceil(math.log10(max(steps, 1)) * PER_DECADE) + 1
    grid = sorted({round(10 ** (k / PER_DECADE)) for k in range(decades + 1)})
    return [step for step in grid if step <= steps]


class _Standing(NamedTuple):
    """Where a run stands: one value, so that an interrupt finds the old one or the new one.

    Attributes:
        leaves: what the compiled loop needs to go on.
        steps: how many were taken.
        low, high: the extremes of the energy since the last sample, J.
        seen: the samples so far, a row each.
    """

    leaves: list[np.ndarray]
    steps: int = 0
    low: float = math.inf
    high: float = -math.inf
    seen: tuple[tuple[float, float, float, float], ...] = ()


_DAMAGED = (
    *(OSError, EOFError, MemoryError, TypeError, AttributeError, NotImplementedError, RuntimeError),
    *(SyntaxError, OverflowError, zlib.error, zipfile.BadZipFile),
)
"""What readers of zip files and arrays raise of damaged ones."""


def _arrays(content: bytes) -> dict[str, np.ndarray]:
    """The arrays of an .npz file, none of which may hold objects."""
    with np.load(io.BytesIO(content), allow_pickle=False) as kept:
        return {name: kept[name] for name in kept.files}


@dataclass
class _LongRun:
    scenario: Scenario
    reference: Reference
    method: str
    precision: str
    dt: float
    folder: Path

    def __post_init__(self) -> None:
        scale = self.reference.scales.energy
        limit = DIVERGENCE * scale + float(abs(self.reference.observables.energy).max())
        run = open_run(self.scenario, self.method, self.dt, self.precision, limit)
        assert isinstance(run, CompiledRun)
        self.run = run
        self.standing = _Standing(run.kept())
        # Energies are compared in one precision each: the samples in float64, what the loop streams in
        # the precision of the run. Both start from the state that this precision holds.
        self.exact = build_system(self.scenario)
        own = build_system(self.scenario, self.precision)
        start = run.position_and_velocity
        with np.errstate(all="ignore"):
            self.start = self._energy_now()
            self.own_start = float(own.energy(*start))

    @property
    def line(self) -> dict[str, Any]:
        names = self.scenario.name, self.method, self.precision, self.dt
        return dict(zip(DRIFT_LINE, names, strict=True))

    @property
    def place(self) -> Path:
        name = f"{self.scenario.name}-{self.method}-{self.precision}-{self.dt!r}.npz"
        return self.folder / name

    @property
    def key(self) -> str:
        """All that the numbers depend on."""
        versions = {name: metadata.version(name) for name in ("umbra-bench", "jax", "jaxlib")}
        return json.dumps(
            {**self.line, **versions, "hash": scenario_hash(self.scenario)}, sort_keys=True
        )

    def take_up(self, restart: bool) -> None:
        """Stand where an earlier run stood, if there was one."""
        if restart:
            self.place.unlink(missing_ok=True)
        if not self.place.is_file():
            return
        content = read_sealed(self.place)
        try:
            kept = _arrays(content)
            key = str(kept["key"])
            if key == self.key:
                self.standing = self._standing(kept)
        except (*_DAMAGED, KeyError, ValueError) as error:
            reason = f"{type(error).__name__}: {one_line(str(error), 200)}"
            raise UmbraBenchError(
                f"{self.place}: cannot be read ({reason}); --restart begins anew"
            ) from None
        if key != self.key:
            raise UmbraBenchError(
                f"{self.place}: was kept by another version or of another scenario than "
                f"{self.scenario.name} is now; --restart begins anew"
            )
        self.run.resume(self.standing.leaves)

    def _standing(self, kept: dict[str, np.ndarray]) -> _Standing:
        """What was kept, if it is such as this run keeps.

        Raises:
            ValueError, KeyError: it is not.
        """
        like = {f"leaf{i}": leaf for i, leaf in enumerate(self.standing.leaves)}
        like |= {"steps": np.array(0), "interval": np.zeros(2)}
        for name, expected in like.items():
            if kept[name].dtype != expected.dtype or kept[name].shape != expected.shape:
                raise ValueError(f"{name} is {kept[name].dtype} of shape {kept[name].shape}")
        leaves = [kept[f"leaf{i}"] for i in range(len(self.standing.leaves))]
        steps, seen = int(kept["steps"]), kept["seen"]
        counted = int(leaves[-2])  # of the loop itself: the last leaves are steps and broken
        if not 0 <= steps == counted <= MOST_STEPS:
            raise ValueError(f"steps is {steps}, and the loop took {counted}")
        if seen.dtype != float or seen.shape != (len(sample_steps(steps)), 4):
            raise ValueError(f"seen is {seen.dtype} of shape {seen.shape}")
        if seen[:, 0].tolist() != sample_steps(steps):
            raise ValueError("seen has other samples than such a run takes")
        low, high = kept["interval"].tolist()
        return _Standing(leaves, steps, low, high, tuple(map(tuple, seen.tolist())))

    def keep(self) -> None:
        """Write where the run stands, whole or not at all."""
        leaves, steps, low, high, seen = self.standing
        numbered: dict[str, Any] = {f"leaf{i}": leaf for i, leaf in enumerate(leaves)}
        with replacing(self.place) as temporary, temporary.open("wb") as file:
            np.savez(
                file,
                key=np.array(self.key),
                steps=np.array(steps),
                seen=np.array(seen).reshape(-1, 4),
                interval=np.array([low, high]),
                **numbered,
            )

    def go_on(self, steps: int, told: Callable[[str, int], None]) -> None:
        """Take steps until `steps` are taken in all, or the energy has left its limit."""
        pace, kept_at = 1e5, time.monotonic()
        samples = set(sample_steps(steps))
        grid = sorted(step for step in samples | {steps} if step > self.standing.steps)
        began, at_first = time.monotonic(), self.standing.steps
        self.keep()  # a folder that cannot be written is told of before the first step
        try:
            for goal in grid:
                while (now := self.standing.steps) < goal and self.run.intact_steps >= now:
                    size = min(goal - now, max(1, int(pace * SLICE_SECONDS)))
                    before = time.monotonic()
                    self._advance(size, samples)
                    after = time.monotonic()
                    if size > 1000:
                        pace = max(1e3, size / max(after - before, 1e-6))
                    if after - kept_at > KEEP_SECONDS:
                        self.keep()
                        kept_at = after
                        done = self.standing.steps
                        told(self._progress(steps, (done - at_first) / (after - began)), done)
        finally:
            self.keep()
        told(f"{self.method} {self.precision}", steps)

    def _progress(self, steps: int, pace: float) -> str:
        done = self.standing.steps
        left = (steps - done) / pace
        return (
            f"{self.method} {self.precision}: {done:.3g} of {steps:.3g} steps, "
            f"{pace:.2g} a second, {left:.0f} s left"
        )

    def _advance(self, size: int, samples: set[int]) -> None:
        recording = self.run.advance(size, 1)
        _, steps, low, high, seen = self.standing
        # NaN is a result: it stays, where min and max of Python would drop it.
        low = float(np.minimum(low, recording.low.energy[0]))
        high = float(np.maximum(high, recording.high.energy[0]))
        standing = _Standing(self.run.kept(), steps + size, low, high, seen)
        if standing.steps in samples:
            seen = (*seen, self._row(standing))
            standing = _Standing(standing.leaves, standing.steps, seen=seen)
        self.standing = standing

    def _row(self, standing: _Standing) -> tuple[float, float, float, float]:
        """Step, energy error at the step, lowest and highest error since the sample before."""
        scale = self.reference.scales.energy
        now = (self._energy_now() - self.start) / scale
        low, high = ((e - self.own_start) / scale for e in (standing.low, standing.high))
        return standing.steps, now, float(np.minimum(low, now)), float(np.maximum(high, now))

    def _energy_now(self) -> float:
        position, velocity = self.run.position_and_velocity
        with np.errstate(all="ignore"):
            return float(self.exact.energy(position.astype(float), velocity.astype(float)))

    def tables(self) -> tuple[pl.DataFrame, pl.DataFrame]:
        """The series of samples, and the law that they follow."""
        steps, rows = self.standing.steps, list(self.standing.seen)
        if not rows or rows[-1][0] != steps:
            rows.append(self._row(self.standing))
        step, error, low, high = np.array(rows).T
        series = pl.DataFrame(
            {
                **{name: [value] * len(rows) for name, value in self.line.items()},
                "step": step.astype(np.int64),
                "t": step * self.dt,
                "energy_error": error,
                "lowest": low,
                "highest": high,
            },
            DRIFT_SERIES_SCHEMA,
        )
        with np.errstate(invalid="ignore"):
            size = np.maximum(abs(low), abs(high))
        intact = step <= self.run.intact_steps
        law = fit_drift_law(step[intact] * self.dt, size[intact])
        broken = self.run.intact_steps < steps
        row = {
            **self.line,
            "steps": steps,
            "energy_error_max": float(size.max()),  # NaN stays NaN
            **law._asdict(),
            "diverged_at": self.run.intact_steps * self.dt if broken else None,
        }
        return series, pl.DataFrame([row], DRIFT_SCHEMA)


def _merge(series: pl.DataFrame, law: pl.DataFrame, results: Path) -> None:
    """Put rows in the place of those of the same scenario, method, precision and step."""
    new = {"drift": (law, DRIFT_SCHEMA), "drift_series": (series, DRIFT_SERIES_SCHEMA)}
    with together(results, "drift") as fresh:  # alone: what is read here is what is replaced
        for name, (rows, schema) in new.items():
            if is_there(results / f"{name}.parquet"):
                old = load_table(name, results, schema).join(rows, on=DRIFT_LINE, how="anti")
                rows = pl.concat([old, rows])
            write_table(rows.sort(DRIFT_LINE, maintain_order=True), name, fresh)


def print_drift(results: Path) -> None:
    """Print the laws, a table of each scenario and step, which fits 100 columns."""
    from rich.console import Console
    from rich.table import Table

    laws = load_table("drift", results, DRIFT_SCHEMA)
    columns = ("steps", "largest", "law", "rate, 1/s", "exponent", "diverged")
    for (scenario, dt), rows in laws.group_by("scenario", "dt", maintain_order=True):
        title = f"{scenario}: energy error over long runs at dt = {dt:g} s"
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        table.add_column("method", no_wrap=True)
        table.add_column("precision", no_wrap=True)
        for column in columns:
            table.add_column(column, justify="right", no_wrap=True)
        for row in rows.to_dicts():
            table.add_row(
                row["method"],
                row["precision"],
                f"{row['steps']:.0e}",
                f"{row['energy_error_max']:.1e}",
                row["law"],
                f"{row['rate']:.2e}" if math.isfinite(row["rate"]) else "",
                f"{row['exponent']:.2f} ± {row['standard_error']:.2f}",
                "" if row["diverged_at"] is None else f"{row['diverged_at']:.4g} s",
            )
        Console(width=100).print(table)
