"""A trajectory as CSV, written while it is computed: memory does not grow with the steps."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from umbra_bench.errors import UmbraBenchError
from umbra_bench.methods import find_method
from umbra_bench.reference import observe_all
from umbra_bench.results import replacing
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import Run, open_run, whole_steps
from umbra_bench.system import build_system, initial_state

HEADER = "t,body,x,y,angle,vx,vy,omega,energy"

CHUNK = 1024
"""Samples in memory at a time."""


def write_trajectory(
    scenario: Scenario,
    method: str,
    dt: float,
    steps: int | None,
    precision: str,
    every: int,
    output: str,
) -> None:
    """Write a row per body every `every` steps, the start and the end included.

    Numbers have as many digits as it takes to read them back exactly in the precision of the run.

    Args:
        steps: None means as many as fit in the scenario's duration.
        output: a file, which appears only when it is complete, or "-" for standard output.

    Raises:
        UmbraBenchError: a step or a method that is not allowed; a file that cannot be written.
    """
    if not (math.isfinite(dt) and dt > 0.0):
        raise UmbraBenchError(f"--dt {dt}: expected a finite number > 0, in s")
    if steps is None:
        steps = whole_steps(scenario, dt)
        if steps == 0:
            raise UmbraBenchError(
                f"--dt {dt}: longer than the duration of {scenario.duration} s of scenario "
                f"{scenario.name}; expected a shorter step, or --steps N"
            )
    run = open_run(scenario, method, dt, precision)
    rows = _rows(run, scenario, find_method(method).precision or precision, dt, steps, every)
    with _opened(output) as file:
        file.write(HEADER + "\n")
        file.writelines(rows)
    if run.intact_steps < steps:
        when = run.intact_steps * dt
        sys.stderr.write(f"umbra-bench: {method} diverged at t = {when:g} s; see the rows\n")


def _rows(
    run: Run, scenario: Scenario, precision: str, dt: float, steps: int, every: int
) -> Iterator[str]:
    system, start = build_system(scenario, precision), initial_state(scenario, precision)
    names = [body.name for body in scenario.bodies]

    def lines(done: np.ndarray, position: np.ndarray, velocity: np.ndarray) -> Iterator[str]:
        energy = observe_all(system, position, velocity).energy
        for n, x, v, e in zip(done, position, velocity, energy, strict=True):
            for i, name in enumerate(names):
                values = (*x[:, i], *v[:, i], e)
                yield f"{float(n * dt)!r},{_quoted(name)},{','.join(map(str, values))}\n"

    yield from lines(np.array([0]), start.position[None], start.velocity[None])
    whole, rest = divmod(steps, every)
    done = 0
    while done < whole:
        samples = min(CHUNK, whole - done)
        recording = run.advance(every, samples)
        counts = every * np.arange(done + 1, done + samples + 1)
        yield from lines(counts, recording.position, recording.velocity)
        done += samples
    if rest:
        recording = run.advance(rest, 1)
        yield from lines(np.array([steps]), recording.position, recording.velocity)


def _quoted(name: str) -> str:
    """A body's name as a CSV field."""
    if any(character in name for character in ',"\r\n'):
        return '"' + name.replace('"', '""') + '"'
    return name


def _is_device(path: Path) -> bool:
    try:
        return path.exists() and not (path.is_file() or path.is_dir())
    except OSError:
        return False


@contextlib.contextmanager
def _opened(output: str) -> Iterator[TextIO]:
    if output == "-":
        yield sys.stdout
        sys.stdout.flush()
        return
    path = Path(output)
    if _is_device(path):
        with path.open("w", encoding="utf-8") as device:  # /dev/null, a pipe: not to be replaced
            yield device
        return
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        yield file
