"""What a large sweep costs: a run, a task, a row; and what follows for 10^9 runs on 1,000 cores.

    python benchmarks/scaling.py

The runs and the rows are those of a sweep of springs; the tasks are empty ones, given to a Dask
scheduler as a sweep gives them. docs/scaling.md quotes the output.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from umbra_bench.sweep.plan import MOST_TASKS, Plan, Task, load_plan
from umbra_bench.sweep.work import run_sweep, run_task

RUNS = 10**9
CORES = 1000
EMPTY_TASKS = 5000


def springs(folder: Path, steps: int, runs: int) -> Plan:
    """A sweep of the spring's stiffness."""
    path = folder / f"springs-{steps}.toml"
    path.write_text(
        f'scenario = "spring"\nmethods = ["umbra"]\nsteps = {steps}\n[[vary]]\n'
        f'key = "forces[0].stiffness"\nrange = {{ start = 1.0, stop = 100.0, count = {runs} }}\n'
    )
    return load_plan(path)


def nothing(plan: Plan, task: Task) -> int:
    """A task that does not do its work."""
    return task.last - task.first


def seconds_a_run(folder: Path, steps: int, runs: int) -> float:
    """In this process, compiled code at hand; the best of three."""
    plan = springs(folder, steps, runs)
    task = Task(0, "umbra", "float64", 0, runs)
    run_task(plan, task)
    taken = []
    for _ in range(3):
        began = time.perf_counter()
        run_task(plan, task)
        taken.append(time.perf_counter() - began)
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


def bytes_a_row(folder: Path) -> float:
    """Of a sweep's table."""
    plan = springs(folder, 100, 20_000)
    return run_sweep(plan, folder).stat().st_size / plan.runs


def main() -> None:
    """Measure, then reckon."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        none, many = (seconds_a_run(folder, steps, 4000) for steps in (1, 10_000))
        pace = tasks_a_second(folder)
        size = bytes_a_row(folder)
    work = RUNS * many
    print(
        f"a run of 10,000 steps: {1e3 * many:.3f} ms, of which {1e3 * none:.3f} before the first step"
    )
    print(f"a step of one of many runs side by side: {(many - none) / 10_000 * 1e9:.1f} ns")
    print(f"a row: {size:.0f} bytes; {RUNS:.0e} rows: {size * RUNS / 1e9:.0f} GB")
    print(f"the scheduler: {pace:.0f} empty tasks a second")
    print(
        f"{RUNS:.0e} runs on {CORES} cores: {work / CORES / 60:.1f} min of computing in {MOST_TASKS} "
        f"tasks of {work / MOST_TASKS:.0f} s, which ask for {CORES * MOST_TASKS / work:.0f} a second"
    )


if __name__ == "__main__":
    main()
