"""A trajectory against the reference: errors, drift, observed order.

A distance between two states is measured per body in the metric of the kinetic energy, so that metres
and radians add up: d^2 = dx^2 + dy^2 + k^2 dangle^2, with k = sqrt(I/m) the radius of gyration. The
largest over the bodies counts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from umbra_bench.umbra.bodies import Bodies

DIVERGENCE = 1e12
"""An energy beyond this multiple of the scenario's energy scale counts as a divergence."""

FLOOR_FACTOR = 10.0
"""An error below this multiple of the reference's certified bound is at the floor."""

SMALL_ERROR = 0.1
"""An error above this part of the motion's own scale is not small: no order is read from it."""

SLOPE_SPREAD = 0.05
"""Successive slopes that differ by no more than this are one asymptotic range."""

LEAST_ORDER = 0.5
"""A smaller slope is an error that saturates (or rounding), not an order."""

LEAST_POINTS = 3
"""The least number of steps in an asymptotic range."""

TOLERANCE = 0.01
"""An error may exceed that of an earlier run by this part of it (and by the round-off floor)."""

ORDER_DROP = 0.1
"""An observed order may fall below that of an earlier run by this much."""


def gyration(bodies: Bodies) -> np.ndarray:
    """Radius of gyration sqrt(I/m) of each body, m, shape (N,); 0 where a body has no mass."""
    mass, inertia = np.asarray(bodies.mass[0], float), np.asarray(bodies.mass[2], float)
    return np.sqrt(np.divide(inertia, mass, out=np.zeros_like(mass), where=mass > 0.0))


def position_distance(position: np.ndarray, other: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The distance of two positions, shape (..., 3, N), m; angles differ by at most pi."""
    gap = position.astype(float) - other
    angle = np.remainder(gap[..., 2, :] + math.pi, 2 * math.pi) - math.pi
    return _largest(gap[..., 0, :], gap[..., 1, :], radius * angle)


def velocity_distance(velocity: np.ndarray, other: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The distance of two velocities, shape (..., 3, N), m/s."""
    gap = velocity.astype(float) - other
    return _largest(gap[..., 0, :], gap[..., 1, :], radius * gap[..., 2, :])


def _largest(x: np.ndarray, y: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Over bodies; infinite where a component is not a number, as after an overflow."""
    distance = np.hypot(np.hypot(x, y), turn).max(axis=-1)
    return np.where(np.isnan(distance), np.inf, distance)


def drift_rate(times: np.ndarray, energy_error: np.ndarray) -> float:
    """The least-squares slope of the energy error over time, 1/s; NaN unless all errors are finite."""
    if not np.all(np.isfinite(energy_error)):
        return math.nan
    centred = times - times.mean()
    return float(centred @ (energy_error - energy_error.mean()) / (centred @ centred))


class Order(NamedTuple):
    """An observed order: the slope of log(error) against log(dt) with its standard error.

    `points` counts the steps in the fit. Without an asymptotic range `order` is NaN and `points` is
    the number of steps whose error was above the floor.
    """

    order: float
    standard_error: float
    points: int

    @property
    def found(self) -> bool:
        return not math.isnan(self.order)


@dataclass(frozen=True)
class ErrorPoint:
    """The error of one step of a sweep.

    `usable` is false at the floor, after a divergence and where the error is not small.
    """

    dt: float
    error: float
    usable: bool


def observed_order(points: Sequence[ErrorPoint]) -> Order:
    """Fit the order over the :func:`asymptotic_range` of the points."""
    fitted = asymptotic_range(points)
    if not fitted:
        return Order(math.nan, math.nan, len(_ordered(points)))
    return _fit(np.log([p.dt for p in fitted]), np.log([p.error for p in fitted]))


def asymptotic_range(points: Sequence[ErrorPoint]) -> list[ErrorPoint]:
    """The finest steps whose successive slopes agree, longest first; empty where there are none.

    From the longest step to the one with the least error (shorter ones only show rounding), the range
    is the one that ends at the shortest possible step, reaches as far towards long steps as slopes
    agree within :data:`SLOPE_SPREAD`, and has at least :data:`LEAST_POINTS` steps and slopes of at
    least :data:`LEAST_ORDER`.
    """
    usable = _ordered(points)
    if len(usable) < LEAST_POINTS:
        return []
    log_dt = np.log([p.dt for p in usable])
    log_error = np.log([p.error for p in usable])
    last = int(np.argmin(log_error))
    slopes = (np.diff(log_error) / np.diff(log_dt))[:last]
    for end in range(len(slopes), LEAST_POINTS - 2, -1):
        begin = end
        while begin > 0 and np.ptp(slopes[begin - 1 : end]) <= SLOPE_SPREAD:
            begin -= 1
        if end - begin >= LEAST_POINTS - 1 and slopes[begin:end].min() >= LEAST_ORDER:
            return usable[begin : end + 1]
    return []


def _ordered(points: Sequence[ErrorPoint]) -> list[ErrorPoint]:
    """The points from which an order can be read, longest step first."""
    return sorted(
        (p for p in points if p.usable and math.isfinite(p.error) and p.error > 0.0),
        key=lambda p: -p.dt,
    )


def _fit(log_dt: np.ndarray, log_error: np.ndarray) -> Order:
    """Linear regression with the standard error of its slope."""
    x, y = log_dt - log_dt.mean(), log_error - log_error.mean()
    slope = float(x @ y / (x @ x))
    residual = y - slope * x
    return Order(slope, math.sqrt(residual @ residual / (len(x) - 2) / (x @ x)), len(x))
