"""Are two methods one? The largest distance of their positions, in units of round-off."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from umbra_bench.metrics import FLOOR_FACTOR, position_distance
from umbra_bench.reference import Reference
from umbra_bench.scenario import Scenario
from umbra_bench.study import run_on_grid
from umbra_bench.system import build_system


class Distance(NamedTuple):
    """How far two methods are apart on a scenario, float64.

    Attributes:
        ulps: the largest distance of their positions, in units in the last place of the largest
            coordinate.
        of_error: the same distance over the first method's own error, which is what tells methods
            apart: one is another method, 1e-6 is the same method. Zero where the first method has
            no error but rounding.
    """

    ulps: float
    of_error: float


def undamped(scenario: Scenario) -> bool:
    """Whether nothing in a scenario depends on the velocity."""
    system = build_system(scenario)
    return system.bodies.damping is None and not system.velocity_dependent


def distance(scenario: Scenario, reference: Reference, one: str, other: str) -> Distance:
    """Run two methods over a scenario at its default step, and compare their positions."""
    dt = scenario.default_step
    a, b = (run_on_grid(scenario, reference, name, dt, "float64") for name in (one, other))
    apart = float(position_distance(a.position, b.position, reference.radius).max())
    shared = slice(None, None, (len(reference.times) - 1) // (len(a.times) - 1))
    error = float(position_distance(a.position, reference.position[shared], reference.radius).max())
    ulp = float(np.spacing(np.abs(reference.position[:, :2]).max()))
    floor = FLOOR_FACTOR * reference.certificate.position + len(a.times) * ulp
    return Distance(apart / ulp, apart / error if error > floor else 0.0)
