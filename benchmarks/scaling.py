"""What a large sweep costs: a run, a task, a row; and what follows for 10^9 runs on 1,000 cores.

    python benchmarks/scaling.py

The runs and the rows are those of a sweep of springs; the tasks are empty ones, given to a Dask
scheduler as a sweep gives them. docs/scaling.md quotes the output.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import polars as pl
from speed import spring_sweep

from umbra_bench.sweep.plan import MOST_TASKS, Plan, Task, load_plan
from umbra_bench.sweep.work import join_parts, run_sweep, run_task

RUNS = 10**9
CORES = 1000
STEPS = 10_000
EMPTY_TASKS = 5000
ROWS = 20_000
PARTS = 200


def springs(folder: Path, steps: int, runs: int) -> Plan:
    """A sweep of the spring's stiffness."""
    return load_plan(spring_sweep(folder, runs, steps))


def nothing(plan: Plan, task: Task) -> int:
    """A task that does not do its work."""
    return task.last - task.first


def seconds_a_run(folder: Path, steps: int, runs: int) -> float:
    """Of one core: the time of all threads together, compiled code at hand; the best of three."""
    plan = springs(folder, steps, runs)
    task = Task(0, "umbra", "float64", 0, runs)
    run_task(plan, task)
    taken = []
    for _ in range(3):
        began = time.process_time()
        run_task(plan, task)
        taken.append(time.process_time() - began)
    return min(taken) / runs


def tasks_a_second(folder: Path) -> float:
    """Of a scheduler with two workers on this machine."""
    from dask import distributed

    plan: Any = springs(folder, 100, EMPTY_TASKS)
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        shared = client.scatter(plan, broadcast=True)
        tasks = [Task(n, "umbra", "float64", n, n + 1) for n in range(EMPTY_TASKS)]
        client.gather([client.submit(nothing, shared, task, pure=False) for task in tasks[:100]])
        began = time.perf_counter()
        futures = [client.submit(nothing, shared, task, pure=False) for task in tasks]
        for _ in distributed.as_completed(futures):
            pass
        return EMPTY_TASKS / (time.perf_counter() - began)


def table_of(folder: Path) -> tuple[float, float]:
    """Bytes a row of a sweep's table, and rows a second when its parts are joined."""
    plan = springs(folder, 100, ROWS)
    table = run_sweep(plan, folder)
    parts = [folder / f"part{n}.parquet" for n in range(PARTS)]
    for part in parts:
        shutil.copy(table, part)
    began = time.perf_counter()
    join_parts(parts, folder / "whole.parquet")
    taken = time.perf_counter() - began
    assert pl.scan_parquet(folder / "whole.parquet").select(pl.len()).collect().item() == (
        PARTS * ROWS
    )
    return table.stat().st_size / plan.runs, PARTS * ROWS / taken


def main() -> None:
    """Measure, then reckon."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        none, many = (seconds_a_run(folder, steps, 4000) for steps in (1, STEPS))
        pace = tasks_a_second(folder)
        size, joined = table_of(folder)
    work = RUNS * many
    print(
        f"a run of {STEPS} steps: {1e3 * many:.3f} ms of a core, {1e3 * none:.3f} before its first"
    )
    print(
        f"a step of one of many runs side by side: {(many - none) / STEPS * 1e9:.1f} ns of a core"
    )
    print(f"the scheduler: {pace:.0f} empty tasks a second")
    print(f"a row: {size:.0f} bytes; joining parts: {joined / 1e6:.1f} million rows a second")
    print(
        f"{RUNS:.0e} runs on {CORES} cores: {work / CORES / 60:.1f} min of computing in {MOST_TASKS} "
        f"tasks of {work / MOST_TASKS:.0f} s, which ask for {CORES * MOST_TASKS / work:.0f} a second; "
        f"{size * RUNS / 1e9:.0f} GB, joined in {RUNS / joined / 60:.0f} min"
    )


if __name__ == "__main__":
    main()
