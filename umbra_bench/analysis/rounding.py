"""Where float32 gives way: the step below which a smaller one makes things worse, and growth in time.

The rounding of one run is what a float32 run differs by from the float64 run of the same method at the
same step. The step is a power of two, so that its own rounding does not enter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from umbra_bench.metrics import position_distance
from umbra_bench.reference import Reference
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import simulate
from umbra_bench.study import measure, run_on_grid

MOST_STEPS = 2_000_000
"""The sweep halves its step until a run needs more steps than this."""

RISE = 1.5
"""By how much an error has to rise again for the least one to be a turning point."""

LONG_STEP = 2.0**-7
LONG_STEPS = 2**21
SAMPLES = 2**12


class Turn(NamedTuple):
    """The sweep of a float32 method over ever shorter steps.

    Attributes:
        steps, errors: dt in s, longest first, and the largest position error in m, shape (K,) each.
        best_step: the dt of the least error, s.
        least_error: over the motion's length scale.
        turned: whether longer and shorter steps than the best were tried, and of the shorter ones
            some did worse by the factor :data:`RISE`.
    """

    steps: np.ndarray
    errors: np.ndarray
    best_step: float
    least_error: float
    turned: bool


def turning_point(scenario: Scenario, reference: Reference, method: str) -> Turn:
    """Sweep a method in float32 until rounding has the upper hand."""
    steps = []
    dt = scenario.dt.start
    while round(scenario.duration / dt) <= MOST_STEPS:
        steps.append(dt)
        dt /= 2
    errors = np.array(
        [
            measure(run_on_grid(scenario, reference, method, dt, "float32"), reference)[
                "position_error_max"
            ]
            for dt in steps
        ]
    )
    best = int(np.argmin(errors))
    return Turn(
        np.array(steps),
        errors,
        steps[best],
        float(errors[best]) / reference.scales.length,
        best > 0 and bool(errors[best:].max() > RISE * errors[best]),
    )


class Growth(NamedTuple):
    """How the rounding of a float32 run grows with time.

    Attributes:
        times: s, shape (K,), spaced by powers.
        position, energy: the largest difference from the float64 run up to each time, m and parts of
            the energy scale, shape (K,) each.
        position_exponent, energy_exponent: the slopes of their logarithms: 1/2 is a random walk, 1
            linear growth; a frequency that wanders adds 1 to the position's.
    """

    times: np.ndarray
    position: np.ndarray
    energy: np.ndarray
    position_exponent: float
    energy_exponent: float


def rounding_growth(scenario: Scenario, reference: Reference, method: str) -> Growth:
    """Run a method in both precisions for millions of steps and follow their difference."""
    single, double = (
        simulate(
            scenario,
            method,
            LONG_STEP,
            steps=LONG_STEPS,
            every=LONG_STEPS // SAMPLES,
            precision=precision,
        )
        for precision in ("float32", "float64")
    )
    position = position_distance(single.position, double.position, reference.radius)
    energy = np.abs(single.at.energy.astype(float) - double.at.energy) / reference.scales.energy
    chosen = np.unique(np.geomspace(8, SAMPLES, 40).astype(int))
    so_far = [np.maximum.accumulate(values)[chosen] for values in (position, energy)]
    return Growth(
        double.times[chosen], *so_far, *(_exponent(double.times[chosen], v) for v in so_far)
    )


def _exponent(times: np.ndarray, values: np.ndarray) -> float:
    """The slope of log(value) against log(time), where the values are finite and not zero."""
    good = np.isfinite(values) & (values > 0.0)
    if good.sum() < 3:
        return float("nan")
    return float(np.polyfit(np.log(times[good]), np.log(values[good]), 1)[0])


def kind_of_growth(exponent: float) -> str:
    """The nearest law, in words."""
    laws = {0.0: "bounded", 0.5: "random walk", 1.0: "linear", 1.5: "t^1.5", 2.0: "quadratic"}
    return laws[min(laws, key=lambda law: abs(law - exponent))] if exponent == exponent else "none"
