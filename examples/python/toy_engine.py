"""An engine in Python, found by umbra-bench through the entry point in `pyproject.toml`.

    pip install ./examples/python
    umbra-bench identify toy-verlet

It keeps the acceleration of the step before, as velocity Verlet does, and asks for the force of the new
positions through `force`, so that nothing lags.
"""

from __future__ import annotations

import numpy as np

from umbra_bench.scenario import Scenario
from umbra_bench.system import build_system, initial_state


class ToyVerlet:
    """Velocity Verlet. The harness calls `step`, then `read`."""

    precision = "float64"
    damps_itself = False

    def __init__(self, scenario: Scenario) -> None:
        self._system = build_system(scenario)
        self._x, self._v = initial_state(scenario)
        self._a = self._system.acceleration(self._x, self._v)

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        """Advance from the state that the harness shows; arrays of shape (3, N), rows x, y, angle."""
        self._x = self._x + self._v * dt + self._a * (dt * dt / 2)
        a = self._system.acceleration(self._x, self._v)
        self._v = self._v + (self._a + a) * (dt / 2)
        self._a = a

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        """Write the state into the two arrays."""
        position[:], velocity[:] = self._x, self._v

    def set_velocity(self, velocity: np.ndarray) -> None:
        """Take the velocity that damping left."""
        self._v = velocity
