"""Where statements are measured: runs, sweeps and references, each made once and shared."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.errors import UmbraBenchError
from umbra_bench.reference import Reference, certified_reference
from umbra_bench.scenario import Body, Scenario, Sweep, load_scenario
from umbra_bench.simulation import Trajectory, simulate
from umbra_bench.study import measure, orders_of, run_on_grid
from umbra_bench.umbra import BodyDefinition, PhysicsService


class Lab:
    """The harness, with UMBRA's place taken by the method that is examined.

    Args:
        subject: the method that stands for UMBRA's integrator, "umbra" unless someone wants to know
            what would change.

    Raises:
        UmbraBenchError: `subject` is no compiled method.
    """

    def __init__(self, subject: str = "umbra") -> None:
        if subject not in COMPILED_METHODS:
            allowed = ", ".join(COMPILED_METHODS)
            raise UmbraBenchError(f"--method {subject!r}: allowed are {allowed}")
        self._subject = subject
        self.examined = False

    @property
    def subject(self) -> str:
        """The method that is examined; asking for it is remembered in `examined`."""
        self.examined = True
        return self._subject

    @functools.lru_cache  # noqa: B019 -- a lab lives as long as its measurements
    def scenario(self, name: str) -> Scenario:
        """A scenario of the project."""
        return load_scenario(name)

    @functools.lru_cache  # noqa: B019
    def reference(self, name: str) -> Reference:
        """The certified reference of a scenario."""
        return certified_reference(self.scenario(name))

    @functools.lru_cache  # noqa: B019
    def sweep(self, name: str, method: str, precision: str = "float64") -> list[dict[str, Any]]:
        """A method over all steps of a scenario: rows as in the study's table."""
        scenario, reference = self.scenario(name), self.reference(name)
        return [
            measure(run_on_grid(scenario, reference, method, dt, precision), reference)
            for dt in scenario.steps
        ]

    def order(self, name: str, method: str, quantity: str = "position") -> float:
        """The observed order of a method on a scenario, float64; NaN where there is none."""
        rows = orders_of(self.sweep(name, method), self.reference(name))
        return float(next(row["order"] for row in rows if row["quantity"] == quantity))

    def at_step(self, name: str, method: str, column: str, dt: float = 0.01) -> float:
        """One number of the sweep, at the step nearest to `dt`."""
        rows = self.sweep(name, method)
        row = min(rows, key=lambda row: abs(math.log(row["dt"] / dt)))
        return float(row[column])

    @functools.lru_cache  # noqa: B019
    def run(
        self,
        name: str,
        method: str,
        dt: float,
        steps: int,
        every: int = 1,
        precision: str = "float64",
    ) -> Trajectory:
        """A run of a method over a scenario, of any length."""
        return simulate(
            self.scenario(name), method, dt, steps=steps, every=every, precision=precision
        )

    def world(
        self,
        *bodies: BodyDefinition,
        gravity: tuple[float, float] = (0.0, 0.0),
        precision: str = "float32",
    ) -> PhysicsService:
        """A game's world with these bodies, handles 0, 1, ..."""
        service = PhysicsService(gravity, precision)
        for body in bodies:
            service.create_body(body)
        return service


def distance_from(centre: Sequence[float], trajectory: Trajectory) -> np.ndarray:
    """How far the first body is from a point at each sample, m."""
    x, y = trajectory.position[:, 0, 0], trajectory.position[:, 1, 0]
    return np.hypot(x - centre[0], y - centre[1])


def particle(
    velocity: tuple[float, float] = (0.0, 0.0),
    *,
    position: tuple[float, float] = (0.0, 0.0),
    gravity: tuple[float, float] = (0.0, 0.0),
    angular_velocity: float = 0.0,
    kept: float = 1.0,
) -> Scenario:
    """One body of 1 kg and 1 kg m^2 that nothing but gravity pulls; `kept`: damping per second."""
    return Scenario(
        name="particle",
        title="Particle",
        family="free_fall",
        description="One free body",
        duration=1.0,
        gravity=gravity,
        linear_damping=kept,
        angular_damping=kept,
        dt=Sweep(start=0.5, halvings=0),
        bodies=(
            Body(
                name="particle",
                mass=1.0,
                position=position,
                velocity=velocity,
                angular_velocity=angular_velocity,
            ),
        ),
    )
