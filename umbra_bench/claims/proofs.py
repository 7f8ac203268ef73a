"""What goes beyond a yes or no: tables and curves of proofs, maps and costs, each by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from umbra_bench.analysis import backward_error, oscillator, rounding, stability, symplectic
from umbra_bench.analysis.identity import distance, undamped
from umbra_bench.analysis.repair import VARIANTS, costs
from umbra_bench.claims.lab import Lab
from umbra_bench.scenario import Spring, list_scenarios
from umbra_bench.simulation import simulate

Row = dict[str, Any]


class Proof(NamedTuple):
    """What one proof measured.

    Attributes:
        rows: of its table.
        curves: of its figure: series, x, and what was measured and predicted there.
    """

    rows: list[Row]
    curves: list[Row]


def _curve(
    series: str,
    x: Iterable[float],
    measured: Iterable[float],
    predicted: Iterable[float] | None = None,
) -> list[Row]:
    x, measured = list(map(float, x)), list(map(float, measured))
    theory = [None] * len(x) if predicted is None else list(map(float, predicted))
    return [
        {"series": series, "x": a, "measured": b, "predicted": c}
        for a, b, c in zip(x, measured, theory, strict=True)
    ]


def prove_symplectic(lab: Lab) -> Proof:
    """J^T Omega J - Omega of every method at many states of two nonlinear scenarios."""
    rows = [
        {
            "scenario": name,
            "method": method,
            **symplectic.symplectic_defect(
                lab.scenario(name), lab.reference(name), method
            )._asdict(),
        }
        for name in ("orbit_eccentric", "elastic_pendulum")
        for method in oscillator.METHODS
    ]
    return Proof(rows, [])


def prove_identity(lab: Lab) -> Proof:
    """The published pipeline's positions against semi-implicit Euler's, on every undamped scenario."""
    rows = [
        {
            "scenario": name,
            **distance(
                lab.scenario(name), lab.reference(name), lab.subject, "semi-implicit-euler"
            )._asdict(),
        }
        for name in list_scenarios()
        if undamped(lab.scenario(name))
    ]
    return Proof(rows, [])


DISCRETE_STEPS = 10_000


def prove_discrete(lab: Lab) -> Proof:
    """Every method's run on the spring against its exact discrete solution, in units of round-off."""
    scenario = lab.scenario("spring")
    body, spring = scenario.bodies[0], scenario.forces[0]
    assert isinstance(spring, Spring)
    assert spring.anchor is not None
    omega, anchor = float(np.sqrt(spring.stiffness / body.mass)), spring.anchor[0]
    start = (omega * (body.position[0] - anchor), body.velocity[0])
    rows = []
    for method in oscillator.METHODS:
        run = simulate(scenario, method, 0.01, steps=DISCRETE_STEPS)
        q, v = oscillator.discrete_solution(method, omega * 0.01, start, DISCRETE_STEPS)
        x = anchor + q / omega
        apart = np.abs(run.position[:, 0, 0] - x).max() / np.spacing(np.abs(x).max())
        speed = np.abs(run.velocity[:, 0, 0] - v).max() / np.spacing(np.abs(v).max())
        rows.append(
            {"method": method, "position_ulps": float(apart), "velocity_ulps": float(speed)}
        )
    return Proof(rows, [])


def prove_backward_error(lab: Lab) -> Proof:
    """Energy oscillation, frequency shift and growth on the spring, predicted and measured."""
    rows, curves = [], []
    for method in backward_error.PREDICTIONS:
        found = backward_error.compare(lab.scenario("spring"), method)
        rows.append(
            {
                "method": method,
                "dt": found.dt,
                "formula": found.formula,
                "energy_mismatch": found.energy_mismatch,
                "shift": found.shift,
                "predicted_shift": found.predicted_shift,
                "shift_mismatch": found.shift_mismatch,
                "growth": found.growth,
                "predicted_growth": found.predicted_growth,
                "growth_mismatch": found.growth_mismatch,
            }
        )
        shown = found.t <= 2 * np.pi  # two periods of the spring
        stride = max(1, shown.sum() // 300)
        parts = (found.t, found.energy, found.predicted_energy)
        curves += _curve(method, *(part[shown][::stride] for part in parts))
    return Proof(rows, curves)


DAMPED = 0.5
"""The part of the velocity kept per second (omega = 1/s) in the damped lines of the stability map."""


def map_stability(lab: Lab) -> Proof:
    """Growth per step against omega dt: eigenvalues of the step that is run, and of theory."""
    steps = np.linspace(0.05, 3.5, 70)
    rows, curves = [], []
    damped = [
        (method, DAMPED)
        for method in dict.fromkeys(("semi-implicit-euler", lab.subject))
        if method in oscillator.METHODS
    ]
    for method, kept in [*((m, 1.0) for m in oscillator.METHODS), *damped]:
        series = method if kept == 1.0 else f"{method}, damped"
        measured = stability.measured_growth(method, steps, kept)
        theory = [oscillator.spectral_radius(method, w, kept**w) for w in steps]
        curves += _curve(series, steps, measured, theory)
        rows.append(
            {
                "series": series,
                "stable_up_to": stability.largest_stable_step(method, kept),
                "distance_from_theory": float(np.abs(measured - theory).max()),
            }
        )
    return Proof(rows, curves)


def map_precision(lab: Lab) -> Proof:
    """For float32: the step below which a smaller one makes things worse, on every scenario."""
    rows, curves = [], []
    for name in list_scenarios():
        turn = rounding.turning_point(lab.scenario(name), lab.reference(name), lab.subject)
        rows.append(
            {
                "scenario": name,
                "best_step": turn.best_step,
                "least_error": turn.least_error,
                "turned": turn.turned,
                "shortest_step": float(turn.steps[-1]),
            }
        )
        relative = turn.errors / lab.reference(name).scales.length
        curves += _curve(name, turn.steps, relative)
    return Proof(rows, curves)


def follow_rounding(lab: Lab) -> Proof:
    """How the rounding of float32 grows over two million steps."""
    rows, curves = [], []
    for name in ("spring", "orbit_circular", "torsion_spring"):
        growth = rounding.rounding_growth(lab.scenario(name), lab.reference(name), lab.subject)
        rows.append(
            {
                "scenario": name,
                "energy_exponent": growth.energy_exponent,
                "energy_law": rounding.kind_of_growth(growth.energy_exponent),
                "position_exponent": growth.position_exponent,
                "position_law": rounding.kind_of_growth(growth.position_exponent),
                "energy": float(growth.energy[-1]),
                "position": float(growth.position[-1]),
                "time": float(growth.times[-1]),
            }
        )
        curves += _curve(f"{name}, energy", growth.times, growth.energy)
        curves += _curve(f"{name}, position", growth.times, growth.position)
    return Proof(rows, curves)


def measure_repair(lab: Lab) -> Proof:
    """The two halves of the repair, alone and together: orders, energy, costs."""
    cost = costs(lab.scenario("orbit_eccentric"))
    rows, curves = [], []
    for method, change in VARIANTS.items():
        orders = {
            f"{quantity}_order_{name}": lab.order(name, method, quantity)
            for name in ("spring", "orbit_eccentric")
            for quantity in ("position", "velocity")
        }
        rows.append(
            {
                "method": method,
                "change": change,
                **orders,
                "energy_error_spring": lab.at_step("spring", method, "energy_error_max"),
                **cost[method]._asdict(),
            }
        )
        sweep = lab.sweep("spring", method)
        curves += _curve(
            method, [row["dt"] for row in sweep], [row["position_error_max"] for row in sweep]
        )
    return Proof(rows, curves)


PROOFS: dict[str, Callable[[Lab], Proof]] = {
    "symplectic": prove_symplectic,
    "identity": prove_identity,
    "discrete": prove_discrete,
    "backward-error": prove_backward_error,
    "stability": map_stability,
    "precision": map_precision,
    "rounding-growth": follow_rounding,
    "repair": measure_repair,
}
"""All proofs, in the order of the page."""
