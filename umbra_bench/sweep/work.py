"""The work of a sweep: tasks, the parts that they write, in this process or on a Dask cluster.

A task is a function of the plan and its number. Whoever runs it writes its part of the table, whole
or not at all, into a folder that all can see, and answers with nothing but a count: the scheduler
carries no results, a worker that dies costs its task, and what is written need not be done again.
"""

from __future__ import annotations

import hashlib
import importlib
import io
import os
import shlex
import shutil
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.errors import EngineFailed, ScenarioError, UmbraBenchError, UnsupportedScenario
from umbra_bench.jax_settings import keep_compiled_code
from umbra_bench.metrics import DIVERGENCE
from umbra_bench.reference import observe_all
from umbra_bench.results import (
    alone_at,
    check_seal,
    is_there,
    load_json,
    replacing,
    save_json,
    together,
)
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import open_run
from umbra_bench.state import kinetic_energy
from umbra_bench.sweep.batch import (
    Outcome,
    Problem,
    batch_size,
    energy_scale,
    run_batch,
    side_by_side,
)
from umbra_bench.sweep.plan import TASK_RUNS, Plan, Task
from umbra_bench.system import build_system, initial_state

_MEASURED: dict[str, Any] = {
    "dt": pl.Float64,
    "steps": pl.Int64,
    "energy_start": pl.Float64,
    "energy_scale": pl.Float64,
    "energy_low": pl.Float64,
    "energy_high": pl.Float64,
    "energy_error_max": pl.Float64,
    "angular_momentum_low": pl.Float64,
    "angular_momentum_high": pl.Float64,
    "diverged_at": pl.Float64,
    "refused": pl.String,
}


def schema(plan: Plan) -> dict[str, Any]:
    """The columns of a sweep's table: a row is a run.

    `run` is its number within a method and precision; then come the keys that vary, under the names
    that the sweep file gives them (a varied `dt` stands in `dt`). Energies in J, `energy_error_max`
    is the largest |E - E(0)| over `energy_scale`, null where the scenario does not conserve energy;
    `refused` says why a run could not be simulated.
    """
    keys = {key: pl.Float64 for key in plan.keys if key not in _MEASURED}
    names = {"run": pl.Int64, "scenario": pl.String, "method": pl.String, "precision": pl.String}
    return {**names, **keys, **_MEASURED}


def run_task(plan: Plan, task: Task) -> pl.DataFrame:
    """The rows of a task, in the order of its runs."""
    if task.last - task.first > TASK_RUNS:
        firsts = range(task.first, task.last, TASK_RUNS)
        slices = (replace(task, first=n, last=min(n + TASK_RUNS, task.last)) for n in firsts)
        return pl.concat([run_task(plan, part) for part in slices])
    measure = _batched if task.method in COMPILED_METHODS else _one_by_one
    rows: dict[int, dict[str, Any]] = {}
    for point, found in measure(task, _runs(plan, task, rows)):
        rows[point] |= found
    return pl.DataFrame(list(rows.values()), schema(plan))


Run = tuple[int, Scenario, float, int]
"""Its number, what is simulated, the step, s, and how many of them."""

Measured = Iterator[tuple[int, dict[str, Any]]]


def _runs(plan: Plan, task: Task, rows: dict[int, dict[str, Any]]) -> Iterator[Run]:
    """The runs of a task, each with a row begun; a run that no scenario allows is a row alone."""
    for point in range(task.first, task.last):
        values = plan.values(point)
        rows[point] = {
            "run": point,
            "scenario": plan.document["name"],
            "method": task.method,
            "precision": task.precision,
            **dict(zip(plan.keys, values, strict=True)),
        }
        try:
            scenario = plan.scenario(values)
            yield point, scenario, *plan.step(values, scenario)
        except ScenarioError as error:
            rows[point]["refused"] = str(error)


def _batched(task: Task, runs: Iterable[Run]) -> Measured:
    """Runs of one shape and number of steps side by side, while the next ones are made ready."""
    dtype = np.dtype(task.precision).type
    alike: dict[Any, list[_Member]] = {}
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        batches = []

        def start(steps: int, members: list[_Member]) -> None:
            # The threads do nothing but step: what is done in Python is done here, in turn.
            batch = side_by_side([problem for _, _, problem in members])
            batches.append((steps, members, pool.submit(run_batch, task.method, batch, steps)))

        for point, scenario, dt, steps in runs:
            try:
                system = build_system(scenario, task.precision)
            except UnsupportedScenario as error:
                yield point, {"refused": str(error)}
                continue
            problem = Problem(system, initial_state(scenario, task.precision), dtype(dt))
            # All runs have the same bodies; which terms their laws have is in the form of the tree.
            shape = steps, jax.tree.structure(problem)
            members = alike.setdefault(shape, [])
            members.append((point, system.conservative, problem))
            if len(members) == batch_size(len(scenario.bodies)):
                start(steps, alike.pop(shape))
        for (steps, _), members in alike.items():
            start(steps, members)
        for steps, members, outcome in batches:
            yield from _rows(steps, members, outcome.result())


_Member = tuple[int, bool, Problem]
"""A run of a batch: its number, whether its energy is conserved, the problem."""


def _rows(steps: int, members: list[_Member], found: Outcome) -> Measured:
    for i, (point, conservative, problem) in enumerate(members):
        extremes = _at(found.low, i), _at(found.high, i)
        numbers = float(problem.dt), steps, float(found.start.energy[i])
        scale, intact = float(found.energy_scale[i]), int(found.intact_steps[i])
        yield point, _row(*numbers, scale, extremes, intact, conservative)


def _one_by_one(task: Task, runs: Iterable[Run]) -> Measured:
    """Runs of an engine, which steps in a program of its own."""
    for point, scenario, dt, steps in runs:
        system, first = build_system(scenario), initial_state(scenario)
        start = float(system.energy(*first))
        scale = float(
            energy_scale(np.asarray(start), kinetic_energy(system.bodies, first.velocity).sum())
        )
        try:
            run = open_run(scenario, task.method, dt, task.precision, DIVERGENCE * scale)
            recording = run.advance(steps, 1)
        except (UnsupportedScenario, EngineFailed) as error:
            yield point, {"refused": str(error)}
            continue
        end = observe_all(system, recording.position, recording.velocity)
        low = [float(min(a[0], b[0])) for a, b in zip(recording.low, end, strict=True)]
        high = [float(max(a[0], b[0])) for a, b in zip(recording.high, end, strict=True)]
        yield (
            point,
            _row(dt, steps, start, scale, (low, high), run.intact_steps, system.conservative),
        )


def _at(observables: Any, i: int) -> list[float]:
    return [float(values[i]) for values in observables]


def _row(
    dt: float,
    steps: int,
    start: float,
    scale: float,
    extremes: tuple[list[float], list[float]],
    intact_steps: int,
    conservative: bool,
) -> dict[str, Any]:
    (energy_low, momentum_low), (energy_high, momentum_high) = extremes
    return {
        "dt": dt,
        "steps": steps,
        "energy_start": start,
        "energy_scale": scale,
        "energy_low": energy_low,
        "energy_high": energy_high,
        "energy_error_max": max(start - energy_low, energy_high - start) / scale
        if conservative
        else None,
        "angular_momentum_low": momentum_low,
        "angular_momentum_high": momentum_high,
        "diverged_at": intact_steps * dt if intact_steps < steps else None,
        "refused": None,
    }


# Where the work is done ---------------------------------------------------------------------------

Listener = Callable[[str, int, int], None]


def run_sweep(
    plan: Plan,
    results: Path,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    restart: bool = False,
    listener: Listener = lambda what, done, total: None,
) -> Path:
    """Run what is left of a sweep and return the path of its table.

    Args:
        plan: from :func:`umbra_bench.sweep.plan.load_plan`.
        results: the folder of results; on a cluster all workers must see it under this path.
        workers: start a Dask cluster of so many processes on this machine.
        scheduler: the address of a Dask scheduler to use instead.
        restart: forget what an earlier run of this sweep left.
        listener: told of every finished task.

    Raises:
        UmbraBenchError: a folder that holds another sweep or cannot be written, another command that
            runs this one, a table that was damaged, no such scheduler.
    """
    table = results.resolve() / "sweeps" / f"{plan.name}.parquet"
    with alone_at(table):
        _claim(plan, table, restart)
        if is_there(table):
            check_seal(table)
        else:
            where = _on_dask(workers, scheduler) if workers or scheduler else _here
            _finish(plan, table, where, listener)
        # Not before the table is there; a command that was killed in between comes by here again.
        shutil.rmtree(_parts_folder(table), ignore_errors=True)
    return table


def _finish(plan: Plan, table: Path, where: Where, listener: Listener) -> None:
    """Run what is left, and join the parts."""
    folder = _parts_folder(table)
    done, total = _sound_parts(folder), len(plan.tasks)
    left = [task for task in plan.tasks if task.number not in done]
    if done:
        listener("found from before", len(done), total)
    for count, task in enumerate(where(plan, left, folder), total - len(left) + 1):
        listener(f"{task.method} {task.precision}, run {task.last}", count, total)
    parts = sorted(folder.glob("*.parquet"))
    with together(table.parent, plan.name) as fresh:
        join_parts(parts, fresh / table.name)


def join_parts(parts: list[Path], table: Path) -> None:
    """Make one table of its parts, which need not fit in memory."""
    with replacing(table) as temporary:
        pl.scan_parquet(parts, glob=False).sink_parquet(temporary)


def _parts_folder(table: Path) -> Path:
    return table.with_suffix("")


def write_part(plan: Plan, task: Task, folder: Path) -> int:
    """Run a task and write its part; return the number of rows.

    The name of a part holds the task's number and the SHA-256 of its bytes.
    """
    rows, file = run_task(plan, task), io.BytesIO()
    rows.write_parquet(file)
    name = f"{task.number:09}-{hashlib.sha256(file.getvalue()).hexdigest()}.parquet"
    with replacing(folder / name) as temporary:
        temporary.write_bytes(file.getvalue())
    return rows.height


def _sound_parts(folder: Path) -> set[int]:
    """The numbers of the tasks whose parts are as they were written; damaged parts are removed."""
    numbers = set()
    for part in folder.glob("*.parquet"):
        number, _, digest = part.stem.partition("-")
        if digest == hashlib.sha256(part.read_bytes()).hexdigest() and number.isdigit():
            numbers.add(int(number))
        else:
            part.unlink()
    return numbers


def _on_worker(plan: Plan, task: Task, folder: Path) -> int:
    """What a worker of a cluster does, which owns its process."""
    keep_compiled_code()
    return write_part(plan, task, folder)


def _claim(plan: Plan, table: Path, restart: bool) -> None:
    """Make sure that what lies in a sweep's place belongs to it."""
    stamp = table.with_suffix(".json")
    if restart:
        shutil.rmtree(_parts_folder(table), ignore_errors=True)
        for old in (table, table.with_suffix(".sha256"), stamp):
            old.unlink(missing_ok=True)
    if not stamp.is_file():
        command = shlex.join(["umbra-bench", "sweep", plan.path, "--restart"])
        stated = {"sweep": plan.name, "fingerprint": plan.fingerprint, "reproduce": command}
        save_json(stated, stamp)
        return
    known = load_json(stamp)
    if not isinstance(known, dict) or known.get("fingerprint") != plan.fingerprint:
        raise UmbraBenchError(
            f"{stamp}: holds another sweep of the name {plan.name!r} than {plan.path} states "
            "now; use --restart to run it anew, or another --results"
        )


Where = Callable[[Plan, list[Task], Path], Iterator[Task]]


def _here(plan: Plan, tasks: list[Task], folder: Path) -> Iterator[Task]:
    for task in tasks:
        write_part(plan, task, folder)
        yield task


def _on_dask(workers: int | None, scheduler: str | None) -> Where:
    """A Dask cluster: a task that raises or loses its worker is tried again by another."""

    def where(plan: Plan, tasks: list[Task], folder: Path) -> Iterator[Task]:
        distributed: Any = importlib.import_module("dask.distributed")
        cluster = None
        if scheduler is None:
            cluster = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50
            )
        try:
            client = distributed.Client(cluster or scheduler, timeout=20)
        except (OSError, ValueError) as error:
            raise UmbraBenchError(f"--scheduler {scheduler}: cannot be reached: {error}") from None
        try:
            shared = client.scatter(plan, broadcast=True)
            futures = {
                client.submit(_on_worker, shared, task, folder, pure=False, retries=2): task
                for task in tasks
            }
            for future in distributed.as_completed(futures):
                future.result()
                yield futures[future]
        finally:
            client.close()
            if cluster is not None:
                cluster.close()

    return where
