"""What an engine offers, and how the harness drives it."""

from __future__ import annotations

import importlib
from importlib import metadata
from typing import Protocol

import numpy as np

from umbra_bench.compiled import Observables, Recording
from umbra_bench.errors import EngineFailed, UmbraBenchError
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.methods import BROUGHT, ENTRY_POINTS, find_method
from umbra_bench.reference import observe_all
from umbra_bench.scenario import Scenario
from umbra_bench.system import System, build_system, initial_state
from umbra_bench.umbra.pipeline import apply_damping

CHUNK = 1024
"""How many states are kept before they are measured: memory does not grow with the steps."""


class Engine(Protocol):
    """A foreign engine with the bodies of one scenario in it. Arrays have shape (3, N), SI units.

    An engine that says `damps_itself` applies the scenario's exponential damping in its own step;
    for all others the harness does.
    """

    damps_itself: bool

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        """Advance by one step from the state given, with forces applied in this engine's mode."""
        ...

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Write the state into the two arrays."""
        ...

    def set_velocity(self, velocity: np.ndarray) -> None:
        """Replace the velocity of every body that forces move."""
        ...


def open_engine(method: str, scenario: Scenario) -> Engine:
    """The engine of a method with a scenario's bodies in it.

    Raises:
        UnsupportedScenario: the engine cannot run this scenario; the message says why.
        UmbraBenchError: the engine is not installed; the message says how to install it.
    """
    if not (known := find_method(method)).installed:
        raise UmbraBenchError(f"--method {method!r}: {known.missing}")
    if method.startswith(BROUGHT):
        from umbra_bench.engines.process import ProcessEngine

        return ProcessEngine(method, scenario)
    try:
        if method in _HOMES:
            module, name = _HOMES[method]
            kind = getattr(importlib.import_module(f"umbra_bench.engines.{module}"), name)
        else:
            (point,) = metadata.entry_points(group=ENTRY_POINTS, name=method)
            kind = point.load()
    except (ImportError, AttributeError) as error:
        raise EngineFailed(f"--method {method!r}: cannot be imported: {error}") from None
    engine: Engine = kind(scenario)
    return engine


_HOMES = {
    "umbra-service": ("umbra_service", "UmbraService"),
    "pymunk": ("pymunk", "ForceBeforeStep"),
    "pymunk-velocity-func": ("pymunk", "ForceInCallback"),
    "pymunk-spring": ("pymunk", "OwnSprings"),
    "box2d": ("box2d", "Box2DWorld"),
    "bullet": ("bullet", "BulletWorld"),
    "physx": ("physx", "PhysXWorld"),
    "mujoco-euler": ("mujoco", "Euler"),
    "mujoco-rk4": ("mujoco", "RungeKutta4"),
}
"""The module and the class of every engine; a module is imported when its engine is asked for."""


class EngineRun:
    """An engine at work on one scenario: the counterpart of a compiled run, with the same recording.

    Exponential damping is the harness's own, after each step, for every foreign engine alike: what is
    measured is the engine's integrator.
    """

    def __init__(
        self, method: str, scenario: Scenario, dt: float, energy_limit: float = float("inf")
    ) -> None:
        self._engine = open_engine(method, scenario)
        self._system: System = build_system(scenario)
        self._dt = dt
        self._limit = min(energy_limit, float(np.finfo(float).max))
        self._intact = True
        self.intact_steps = 0
        start = initial_state(scenario)
        self._position, self._velocity = start.position, start.velocity

    def advance(self, stride: int, samples: int) -> Recording:
        """Take `stride` x `samples` steps and return the samples."""
        shape = (samples, *self._position.shape)
        position, velocity = np.empty(shape), np.empty(shape)
        low = Observables(*(np.full(samples, np.inf) for _ in Observables._fields))
        high = Observables(*(np.full(samples, -np.inf) for _ in Observables._fields))
        total = stride * samples
        with np.errstate(all="ignore"), float64_allowed():
            for begin in range(0, total, CHUNK):
                steps = np.arange(begin, min(begin + CHUNK, total))
                x, v = self._take_steps(len(steps))
                seen = observe_all(self._system, x, v)
                self._watch(seen.energy)
                for least, most, values in zip(low, high, seen, strict=True):
                    np.minimum.at(least, steps // stride, values)
                    np.maximum.at(most, steps // stride, values)
                at_sample = (steps % stride == 0) & (steps > 0)
                position[steps[at_sample] // stride - 1] = x[at_sample]
                velocity[steps[at_sample] // stride - 1] = v[at_sample]
        position[-1], velocity[-1] = self._position, self._velocity
        return Recording(position, velocity, low, high)

    def _take_steps(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Take steps and return the states before each of them, shape (count, 3, N)."""
        shape = (count, *self._position.shape)
        position, velocity = np.empty(shape), np.empty(shape)
        damping = None if self._engine.damps_itself else self._system.bodies.damping
        for n in range(count):
            position[n], velocity[n] = self._position, self._velocity
            self._engine.step(self._dt, self._position, self._velocity)
            self._engine.read(self._position, self._velocity)
            if damping is not None:
                self._velocity = apply_damping(self._velocity, damping, self._dt)
                self._engine.set_velocity(self._velocity)
        return position, velocity

    def _watch(self, energy: np.ndarray) -> None:
        """Count the steps up to the first whose energy is not finite or beyond its limit."""
        within = np.abs(energy) <= self._limit
        if self._intact:
            self.intact_steps += int(len(within) if within.all() else np.argmin(within))
            self._intact = bool(within.all())
