"""A method over a scenario: the one door to everything that moves."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from umbra_bench.compiled import CompiledRun, Observables, Recording
from umbra_bench.engines import EngineRun
from umbra_bench.errors import UmbraBenchError
from umbra_bench.methods import find_method
from umbra_bench.reference import observe_all, solve_reference
from umbra_bench.scenario import Scenario
from umbra_bench.state import State
from umbra_bench.system import build_system, initial_state

MOST_STEPS = 2**62
"""The most steps that a run can count."""


class Run(Protocol):
    """A method at work: each call goes on where the one before ended."""

    @property
    def intact_steps(self) -> int:
        """For how many steps from the start the energy was finite and within its limit."""
        ...

    def advance(self, stride: int, samples: int) -> Recording:
        """Take `stride` x `samples` steps and return the samples."""
        ...


class ReferenceRun:
    """The reference as if it took steps: solved anew from sample to sample."""

    def __init__(self, scenario: Scenario, dt: float) -> None:
        self._scenario, self._dt = scenario, dt
        self.intact_steps = 0

    def advance(self, stride: int, samples: int) -> Recording:
        """Return the states after each of `samples` times `stride` steps."""
        done = self.intact_steps
        steps = np.concatenate([[0], done + stride * np.arange(1, samples + 1)])
        position, velocity = solve_reference(self._scenario, self._dt * steps)
        observables = observe_all(build_system(self._scenario), position, velocity)
        at = Observables(*(values[1:] for values in observables))
        self.intact_steps = int(steps[-1])
        return Recording(position[1:], velocity[1:], at, at)


def open_run(
    scenario: Scenario,
    method: str,
    dt: float,
    precision: str = "float64",
    energy_limit: float = float("inf"),
) -> Run:
    """Put a method to work on a scenario.

    Args:
        method: a name of :data:`umbra_bench.methods.METHODS`.
        dt: the step, s.
        precision: "float32" or "float64"; an engine keeps its own.
        energy_limit: J; beyond it a run counts as diverged.

    Raises:
        UmbraBenchError: unknown method, or an engine that is missing or cannot do the scenario.
    """
    kept = np.dtype(find_method(method).precision or precision)
    with np.errstate(over="ignore"):
        represented = float(kept.type(dt))
    if not 0.0 < represented < float("inf"):
        raise UmbraBenchError(f"--dt {dt}: is {represented} in {kept}; expected a number between")
    match find_method(method).kind:
        case "reference":
            return ReferenceRun(scenario, dt)
        case "engine":
            return EngineRun(method, scenario, dt, energy_limit)
        case _:
            system = build_system(scenario, precision)
            start = initial_state(scenario, precision)
            return CompiledRun(method, system, start, dt, energy_limit)


@dataclass(frozen=True)
class Trajectory:
    """A run that was sampled at equal intervals, its start and its end included.

    Attributes:
        times: s, shape (S + 1,).
        position, velocity: shape (S + 1, 3, N), rows x, y, angle; m, rad, m/s, rad/s.
        at: energy (J) and momenta at the samples, shape (S + 1,).
        low, high: their extremes over the steps of each interval, shape (S,).
        diverged_at: s; the first time at which the energy was not finite or beyond its limit.
        wall_time: s, of the steps alone, without compilation.
    """

    scenario: str
    method: str
    precision: str
    dt: float
    steps: int
    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    at: Observables
    low: Observables
    high: Observables
    diverged_at: float | None
    wall_time: float


def simulate(
    scenario: Scenario,
    method: str = "umbra",
    dt: float = 0.01,
    *,
    steps: int | None = None,
    every: int = 1,
    precision: str = "float64",
    energy_limit: float = float("inf"),
) -> Trajectory:
    """Run a method over a scenario and keep every `every`-th state.

    Args:
        scenario: from :func:`umbra_bench.load_scenario`.
        method, dt, precision, energy_limit: as in :func:`open_run`.
        steps: how many steps to take; by default as many as fit in the scenario's duration.
        every: the number of steps between two samples; must divide `steps`.

    Raises:
        UmbraBenchError: as :func:`open_run`, or steps that `every` does not divide.
    """
    steps = whole_steps(scenario, dt) if steps is None else steps
    if every < 1 or steps % every:
        raise UmbraBenchError(f"every = {every}: must divide the {steps} steps of the run")
    run = open_run(scenario, method, dt, precision, energy_limit)
    samples = steps // every
    if isinstance(run, CompiledRun):
        run.compile(samples)
    began = time.perf_counter()
    recording = run.advance(every, samples)
    wall_time = time.perf_counter() - began
    kept = find_method(method).precision or precision
    start = initial_state(scenario, kept)
    position = np.concatenate([start.position[None], recording.position])
    velocity = np.concatenate([start.velocity[None], recording.velocity])
    at = observe_all(build_system(scenario, kept), position, velocity)
    times = dt * every * np.arange(samples + 1)
    return Trajectory(
        scenario=scenario.name,
        method=method,
        precision=kept,
        dt=dt,
        steps=steps,
        times=times,
        position=position,
        velocity=velocity,
        at=at,
        low=recording.low,
        high=recording.high,
        diverged_at=_divergence(
            State(position, velocity), at.energy, times, run.intact_steps, steps, dt, energy_limit
        ),
        wall_time=wall_time,
    )


def whole_steps(scenario: Scenario, dt: float) -> int:
    """How many steps of `dt` fit in the duration; a last one short by rounding alone is one.

    Raises:
        UmbraBenchError: more than can be counted.
    """
    steps = scenario.duration / dt * (1 + 1e-9)
    if not steps <= MOST_STEPS:
        raise UmbraBenchError(
            f"--dt {dt}: too short for {scenario.duration} s; expected fewer steps"
        )
    return int(steps)


def _divergence(
    state: State,
    energy: np.ndarray,
    times: np.ndarray,
    intact_steps: int,
    steps: int,
    dt: float,
    limit: float,
) -> float | None:
    """The time of the first state that was not finite or whose energy was beyond the limit."""
    if intact_steps < steps:
        return intact_steps * dt
    finite = np.isfinite(state.position).all(axis=(1, 2))
    finite &= np.isfinite(state.velocity).all(axis=(1, 2))
    finite &= np.isfinite(energy) & (np.abs(energy) <= limit)
    return None if finite.all() else float(times[np.argmin(finite)])
