"""Observed orders and errors: the physics page, measured; and how an order is observed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import polars as pl
import pytest
from problems import EPS, spring

from umbra_bench.metrics import ErrorPoint, Order, observed_order
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import simulate
from umbra_bench.study import Study, run_study

# The physics page, measured -----------------------------------------------------------------------

METHODS = (
    "explicit-euler",
    "semi-implicit-euler",
    "velocity-verlet",
    "rk4",
    "yoshida4",
    "umbra",
    "umbra-repaired",
)

ORDERS = {
    "semi-implicit-euler": (1.0, 0.05),
    "umbra": (1.0, 0.05),
    "velocity-verlet": (2.0, 0.05),
    "umbra-repaired": (2.0, 0.05),
    "rk4": (4.0, 0.1),
    "yoshida4": (4.0, 0.1),
}
"""The order of the position, and how near an observed one has to be."""


@pytest.fixture(scope="session")
def released() -> Scenario:
    """omega = 2 rad/s, released at rest from 1 m, over three periods."""
    sweep = {"start": 0.02, "halvings": 2}
    return spring((1.0, 0.0), (0.0, 0.0), duration=10.0, dt=sweep)


@pytest.fixture(scope="session")
def study(load: Callable[[str], Scenario], released: Scenario) -> Study:
    scenarios = [load("spring"), load("orbit_eccentric"), released]
    return run_study(scenarios, METHODS, ["float64"])


def order_of(study: Study, scenario: str, method: str, quantity: str) -> Order:
    row = study.orders.row(
        by_predicate=(pl.col("scenario") == scenario)
        & (pl.col("method") == method)
        & (pl.col("quantity") == quantity),
        named=True,
    )
    return Order(row["order"], row["standard_error"], row["points"])


@pytest.mark.parametrize("scenario", ["spring", "orbit_eccentric"])
@pytest.mark.parametrize("method", ORDERS)
def test_order_of_the_position(study: Study, scenario: str, method: str) -> None:
    order, tolerance = ORDERS[method]
    found = order_of(study, scenario, method, "position")
    assert found.order == pytest.approx(order, rel=0, abs=tolerance)
    assert found.points >= 3


def test_explicit_euler_is_of_first_order_on_the_spring(study: Study) -> None:
    found = order_of(study, "spring", "explicit-euler", "position")
    assert found.order == pytest.approx(1.0, rel=0, abs=0.05)


@pytest.mark.parametrize(
    ("method", "order"),
    [("semi-implicit-euler", 1), ("umbra", 1), ("velocity-verlet", 2), ("umbra-repaired", 2)],
)
@pytest.mark.parametrize("quantity", ["velocity", "energy"])
def test_order_of_velocity_and_energy_from_a_generic_start(
    study: Study, method: str, order: int, quantity: str
) -> None:
    found = order_of(study, "spring", method, quantity)
    assert found.order == pytest.approx(order, rel=0, abs=0.05)


def test_release_from_rest_flatters_the_velocity_of_semi_implicit_euler(study: Study) -> None:
    # Order 2 there and 1 from a generic start: the reason why scenarios start generically.
    assert order_of(study, "problem", "semi-implicit-euler", "velocity").order == pytest.approx(
        2.0, rel=0, abs=0.05
    )
    assert order_of(study, "problem", "umbra", "velocity").order == pytest.approx(
        1.0, rel=0, abs=0.05
    )


@pytest.mark.parametrize(
    ("method", "published"),
    [
        ("semi-implicit-euler", [2.04e-2, 1.01e-2, 5.03e-3]),
        ("umbra", [4.02e-2, 2.01e-2, 1.00e-2]),
        ("velocity-verlet", [4.00e-4, 1.00e-4, 2.50e-5]),
        ("umbra-repaired", [4.00e-4, 1.00e-4, 2.50e-5]),
    ],
)
def test_energy_errors_of_the_physics_page(
    study: Study, method: str, published: Sequence[float]
) -> None:
    rows = study.runs.filter(scenario="problem", method=method).sort("dt", descending=True)
    np.testing.assert_allclose(rows["dt"], [0.02, 0.01, 0.005])
    np.testing.assert_allclose(rows["energy_error_max"], published, rtol=0.01)  # as printed


def test_explicit_euler_gains_energy_at_every_step(released: Scenario) -> None:
    dt, steps = 0.01, 1000
    energy = simulate(released, "explicit-euler", dt, steps=steps).at.energy
    # 4 J, times |lambda|^2 = 1 + omega^2 dt^2 a step; a few roundings in each of n steps.
    expected = 4.0 * (1 + (2.0 * dt) ** 2) ** np.arange(steps + 1)
    np.testing.assert_allclose(energy, expected, rtol=steps * 4 * EPS)


@pytest.mark.parametrize(
    ("method", "published"), [("pymunk", 1.13e-1), ("pymunk-velocity-func", 6.66e-3)]
)
def test_position_errors_of_pymunk(released: Scenario, method: str, published: float) -> None:
    run = simulate(released, method, 5.0 / 400, steps=400, every=400)
    x, y = run.position[-1, :2, 0]
    assert math.hypot(x - math.cos(2.0 * 5.0), y) == pytest.approx(published, rel=0.01)


def test_a_force_set_before_pymunks_step_is_explicit_euler(released: Scenario) -> None:
    steps = 400
    engine = simulate(released, "pymunk", 0.0125, steps=steps)
    euler = simulate(released, "explicit-euler", 0.0125, steps=steps)
    # A few roundings in each of n steps of numbers of order 1 to 3.
    atol = 8 * steps * EPS
    np.testing.assert_allclose(engine.position, euler.position, rtol=0, atol=atol)
    np.testing.assert_allclose(engine.velocity, euler.velocity, rtol=0, atol=atol)


# How an order is observed -------------------------------------------------------------------------

STEPS = [0.04 / 2**k for k in range(8)]


def points(errors: Sequence[float], floor: float = 0.0) -> list[ErrorPoint]:
    return [ErrorPoint(dt, error, error >= floor) for dt, error in zip(STEPS, errors, strict=False)]


@pytest.mark.parametrize("power", [1.0, 2.0, 3.5, 4.0])
def test_an_exact_power_law_has_its_power(power: float) -> None:
    found = observed_order(points([3.0 * dt**power for dt in STEPS]))
    assert found.order == pytest.approx(power, rel=1e-13)  # logarithms round to 1e-15
    assert found.standard_error < 1e-13
    assert found.points == len(STEPS)
    assert found.found


def test_the_points_may_come_in_any_order() -> None:
    sweep = points([3.0 * dt**2 for dt in STEPS])
    assert observed_order(sweep[::-1]) == observed_order(sweep)


def test_points_at_the_floor_are_left_out() -> None:
    floor = 1e-10
    found = observed_order(points([max(dt**4, floor / 2) for dt in STEPS], floor))
    assert found.order == pytest.approx(4.0, rel=1e-13)
    assert found.points == sum(dt**4 >= floor for dt in STEPS) == 4


def test_steps_beyond_the_least_error_only_show_rounding() -> None:
    # Rounding grows as 1/dt; from dt = 0.005 on it is all there is.
    errors = [dt**4 if dt > 0.004 else 1e-8 * STEPS[4] / dt for dt in STEPS]
    found = observed_order(points(errors))
    assert found.order == pytest.approx(4.0, rel=1e-13)
    assert found.points == 4


def test_a_slope_beyond_the_least_error_is_no_order() -> None:
    # A tail that happens to have a steady slope, all of it above the least error.
    errors = [dt**4 if dt > 0.004 else 1e-4 * dt**0.6 for dt in STEPS]
    found = observed_order(points(errors))
    assert found.order == pytest.approx(4.0, rel=1e-13)
    assert found.points == 4


def test_saturated_errors_at_long_steps_are_left_out() -> None:
    found = observed_order(points([2.0, 2.0, 2.0, *((dt / 0.01) ** 2 for dt in STEPS[3:])]))
    assert found.order == pytest.approx(2.0, rel=1e-13)
    assert found.points == 5


def test_errors_that_only_saturate_have_no_order() -> None:
    found = observed_order(points([2.0, 1.9, 1.8, 1.7, 1.6, 1.5, 1.4, 1.3]))
    assert not found.found
    assert math.isnan(found.order)
    assert math.isnan(found.standard_error)
    assert found.points == 8


def test_the_range_of_the_shortest_steps_counts() -> None:
    errors = [dt**2 if dt > 0.002 else 0.0025 * dt for dt in STEPS]
    found = observed_order(points(errors))
    assert found.order == pytest.approx(1.0, rel=1e-13)


def test_two_points_are_too_few() -> None:
    found = observed_order(points([0.04, 0.02]))
    assert not found.found
    assert found.points == 2


def test_no_points_have_no_order() -> None:
    assert not observed_order([]).found
    assert observed_order([]).points == 0


def test_noise_has_no_order() -> None:
    errors = [1.0, 0.1, 0.09, 0.01, 0.009, 0.001, 0.0009, 0.0001]
    assert not observed_order(points(errors)).found


def test_a_bent_curve_has_no_order() -> None:
    # Slopes 3, 2.8, 2.6, ...: no three steps agree.
    logs = np.concatenate([[0.0], np.cumsum(3.0 - 0.2 * np.arange(7))])
    assert not observed_order(points(list(2.0**-logs))).found


def test_diverged_and_infinite_and_zero_errors_are_no_points() -> None:
    errors = [dt**2 for dt in STEPS]
    sweep = points([math.inf, math.nan, 0.0, *errors[3:]])
    found = observed_order([*sweep, ErrorPoint(0.08, 1e-9, False)])
    assert found.order == pytest.approx(2.0, rel=1e-13)
    assert found.points == 5


def test_the_standard_error_is_that_of_linear_regression() -> None:
    # Slopes that alternate by 0.03 about 2: one asymptotic range.
    errors = [dt**2 * (1 + 0.005 * (-1) ** k) for k, dt in enumerate(STEPS)]
    found = observed_order(points(errors))
    fit, covariance = np.polyfit(np.log(STEPS), np.log(errors), 1, cov=True)
    assert found.points == len(STEPS)
    assert found.order == pytest.approx(fit[0], rel=1e-10)
    assert found.standard_error == pytest.approx(math.sqrt(covariance[0, 0]), rel=1e-10)
    assert found.standard_error > 0.0
