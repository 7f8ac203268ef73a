"""Backward error analysis on the spring: what each method really integrates, predicted and measured.

A method's numbers are the exact solution of a neighbouring problem. On x'' = -omega^2 x the leading
term of the difference is known in closed form: how the energy oscillates, by how much the frequency
is shifted, and how fast the energy grows. Predicted here from theory, measured from runs.

Source: Hairer, Lubich, Wanner, Geometric Numerical Integration, IX.3 (modified equations); for the
published pipeline the substitution u = v + a dt/2, which makes it semi-implicit Euler.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from umbra_bench.analysis.oscillator import YOSHIDA
from umbra_bench.closed_form import solve_closed_form
from umbra_bench.scenario import Scenario, Spring
from umbra_bench.simulation import Trajectory, simulate


class Motion(NamedTuple):
    """The exact motion of an oscillator, shape (S,) each: q = omega x and v, both in m/s; t in s."""

    q: np.ndarray
    v: np.ndarray
    t: np.ndarray


class Prediction(NamedTuple):
    """The leading terms for one method, with w = omega dt.

    Attributes:
        energy: the energy error per mass over time, m^2/s^2, from the exact motion, omega and dt.
        formula: the same, to read.
        shift: (numerical - true frequency)/(true frequency).
        growth: the energy's growth rate over omega.
        step: the dt at which it is compared: small enough for the next term, large enough for
            rounding, s.
    """

    energy: Callable[[Motion, float, float], np.ndarray]
    formula: str
    shift: Callable[[float], float]
    growth: Callable[[float], float]
    step: float


def _growing(rate: Callable[[float], float]) -> Callable[[Motion, float, float], np.ndarray]:
    def energy(m: Motion, omega: float, dt: float) -> np.ndarray:
        start = (m.q[0] ** 2 + m.v[0] ** 2) / 2
        return start * np.expm1(rate(omega * dt) * omega * m.t)

    return energy


def _swinging_with_place(
    factor: Callable[[float], float],
) -> Callable[[Motion, float, float], np.ndarray]:
    def energy(m: Motion, omega: float, dt: float) -> np.ndarray:
        return factor(omega * dt) * (m.q**2 - m.q[0] ** 2)

    return energy


def _semi_implicit(m: Motion, omega: float, dt: float) -> np.ndarray:
    return omega * dt / 2 * (m.q * m.v - m.q[0] * m.v[0])


def _published(m: Motion, omega: float, dt: float) -> np.ndarray:
    # Half a kick more than semi-implicit Euler, but the first frame starts without it.
    return omega * dt * (m.q * m.v - m.q[0] * m.v[0] / 2)


def _yoshida_constants() -> tuple[float, float]:
    """The w^4 terms of Yoshida's method: of the modified stiffness, and of the frequency."""
    one, w = Polynomial([1.0]), Polynomial([0.0, 1.0])
    matrix = [[one, 0 * w], [0 * w, one]]
    for fraction in YOSHIDA:
        half, whole = -fraction / 2 * w, fraction * w
        for shear in ([[one, 0 * w], [half, one]], [[one, whole], [0 * w, one]]):
            matrix = _times(shear, matrix)
        matrix = _times([[one, 0 * w], [half, one]], matrix)
    (diagonal, upper), (lower, _) = matrix
    # q^2 (-lower) + v^2 upper is conserved: its ratio is the modified stiffness, 1 + kappa w^4.
    kappa = -lower.coef[5] - upper.coef[5]
    # cos(w + delta w^5) = the diagonal, 1 - w^2/2 + w^4/24 + c w^6.
    delta = -(diagonal.coef[6] + 1 / 720)
    return float(kappa), float(delta)


def _times(a: list[list[Polynomial]], b: list[list[Polynomial]]) -> list[list[Polynomial]]:
    return [[a[i][0] * b[0][j] + a[i][1] * b[1][j] for j in range(2)] for i in range(2)]


_KAPPA, _DELTA = _yoshida_constants()

_VERLET = Prediction(
    _swinging_with_place(lambda w: w**2 / 8),
    "ω² (ω dt)²/8 · (x² − x₀²)",
    lambda w: w**2 / 24,
    lambda w: 0.0,
    0.01,
)

PREDICTIONS: dict[str, Prediction] = {
    "explicit-euler": Prediction(
        _growing(lambda w: w), "E₀ (exp(ω² dt t) − 1)", lambda w: -(w**2) / 3, lambda w: w, 0.001
    ),
    "semi-implicit-euler": Prediction(
        _semi_implicit,
        "ω² dt/2 · (x v − x₀ v₀)",
        lambda w: w**2 / 24,
        lambda w: 0.0,
        0.001,
    ),
    "velocity-verlet": _VERLET,
    "rk4": Prediction(
        _growing(lambda w: -(w**5) / 72),
        "−E₀ (1 − exp(−ω (ω dt)⁵ t/72))",
        lambda w: -(w**4) / 120,
        lambda w: -(w**5) / 72,
        0.04,
    ),
    "yoshida4": Prediction(
        _swinging_with_place(lambda w: -_KAPPA / 2 * w**4),
        f"ω² · {-_KAPPA / 2:.4f} (ω dt)⁴ · (x² − x₀²)",
        lambda w: _DELTA * w**4,
        lambda w: 0.0,
        0.02,
    ),
    "umbra": Prediction(
        _published,
        "ω² dt · (x v − x₀ v₀/2)",
        lambda w: w**2 / 24,
        lambda w: 0.0,
        0.001,
    ),
    "umbra-repaired": _VERLET,
}


class Comparison(NamedTuple):
    """Theory against a run, on one spring.

    Attributes:
        energy_mismatch: the largest distance of the two energy curves over the predicted one's size.
        shift, predicted_shift: the frequency's relative shift, measured and predicted.
        growth, predicted_growth: the energy's growth rate over omega, ditto.
        t, energy, predicted_energy: the curves over the first seconds, for the figure, in parts of
            the energy.
    """

    method: str
    dt: float
    formula: str
    energy_mismatch: float
    shift: float
    predicted_shift: float
    growth: float
    predicted_growth: float
    t: np.ndarray
    energy: np.ndarray
    predicted_energy: np.ndarray

    @property
    def shift_mismatch(self) -> float:
        """The distance of the two shifts over the predicted one."""
        return abs(self.shift / self.predicted_shift - 1.0)

    @property
    def growth_mismatch(self) -> float:
        """The distance of the two growth rates over the predicted one; of none, in units of w."""
        if self.predicted_growth == 0.0:
            return abs(self.growth)
        return abs(self.growth / self.predicted_growth - 1.0)


def compare(scenario: Scenario, method: str) -> Comparison:
    """Run a method on a spring of no rest length that carries one body, and compare with theory.

    Args:
        scenario: one body on one spring of no rest length, no gravity, no damping.
        method: a name in :data:`PREDICTIONS`.
    """
    prediction = PREDICTIONS[method]
    dt = prediction.step
    body, spring = scenario.bodies[0], scenario.forces[0]
    assert isinstance(spring, Spring)
    omega = math.sqrt(spring.stiffness / body.mass)
    run = simulate(scenario, method, dt)
    position, velocity = solve_closed_form(scenario, run.times)
    anchor = np.array(spring.anchor)
    motions = [
        Motion(omega * (position[:, row, 0] - anchor[row]), velocity[:, row, 0], run.times)
        for row in (0, 1)
    ]
    scale = sum(float(m.q[0] ** 2 + m.v[0] ** 2) / 2 for m in motions)
    predicted = np.sum([prediction.energy(m, omega, dt) for m in motions], axis=0) / scale
    energy = run.at.energy.astype(float)
    measured = (energy - energy[0]) / (body.mass * scale)
    shift, growth = _shift_and_growth(run, float(anchor[0]), omega)
    return Comparison(
        method=method,
        dt=dt,
        formula=prediction.formula,
        energy_mismatch=float(np.abs(measured - predicted)[1:].max() / np.abs(predicted).max()),
        shift=shift,
        predicted_shift=prediction.shift(omega * dt),
        growth=growth,
        predicted_growth=prediction.growth(omega * dt),
        t=run.times,
        energy=measured,
        predicted_energy=predicted,
    )


def _shift_and_growth(run: Trajectory, anchor: float, omega: float) -> tuple[float, float]:
    """Frequency and growth of the positions, by Prony's method.

    A motion r^n cos(theta n + phase) satisfies x(n+k) + r^(2k) x(n-k) = 2 r^k cos(k theta) x(n) for
    every k: two unknowns, found by least squares. A stride k of about a quarter period makes them
    well conditioned, however small the step.
    """
    stride = max(1, round(math.pi / 2 / (omega * run.dt)))
    x = run.position[:, 0, 0] - anchor
    before, at, after = x[: -2 * stride], x[stride:-stride], x[2 * stride :]
    (twice_cosine, square), *_ = np.linalg.lstsq(np.stack([at, -before], axis=1), after)
    growth = math.sqrt(square)  # r^k
    angle = math.acos(twice_cosine / (2 * growth))
    turned = stride * omega * run.dt
    return angle / turned - 1.0, 2 * math.log(growth) / turned
