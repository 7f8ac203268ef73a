"""Theory against what runs: the laws that the claims page relies on."""

from __future__ import annotations

import math

import numpy as np
import pytest

from umbra_bench.analysis import backward_error, oscillator, stability, symplectic
from umbra_bench.analysis.identity import distance, undamped
from umbra_bench.analysis.repair import VARIANTS, _force_evaluations, _numbers
from umbra_bench.analysis.rounding import _exponent, kind_of_growth, turning_point
from umbra_bench.reference import Reference, certified_reference
from umbra_bench.scenario import load_scenario
from umbra_bench.simulation import simulate

SYMPLECTIC = ("semi-implicit-euler", "velocity-verlet", "yoshida4")


@pytest.fixture(scope="module")
def orbit() -> Reference:
    return certified_reference(load_scenario("orbit_eccentric"))


# The linear oscillator -----------------------------------------------------------------------------


@pytest.mark.parametrize("method", SYMPLECTIC)
@pytest.mark.parametrize("w", [0.01, 0.7, 1.9, 3.0])
def test_a_symplectic_method_keeps_the_area_at_every_step(method: str, w: float) -> None:
    assert np.linalg.det(oscillator.amplification(method, w)) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("method", ["umbra", "umbra-repaired"])
def test_a_pipeline_forgets_its_oldest_acceleration(method: str) -> None:
    assert np.linalg.det(oscillator.amplification(method, 0.7)) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("method", ["umbra", "umbra-repaired", "rk4"])
def test_a_run_is_its_exact_discrete_solution(method: str) -> None:
    scenario = load_scenario("spring")
    run = simulate(scenario, method, 0.05, steps=1000)
    start = (2.0 * (1.1 - 0.1), -0.4)
    q, v = oscillator.discrete_solution(method, 2.0 * 0.05, start, 1000)
    scale = max(abs(q).max(), abs(v).max())
    np.testing.assert_allclose(run.position[:, 0, 0], 0.1 + q / 2.0, rtol=0, atol=1e-11 * scale)
    np.testing.assert_allclose(run.velocity[:, 0, 0], v, rtol=0, atol=1e-11 * scale)


@pytest.mark.parametrize("method", oscillator.METHODS)
@pytest.mark.parametrize("kept", [1.0, 0.5])
def test_growth_per_step_is_that_of_theory(method: str, kept: float) -> None:
    steps = np.array([0.1, 1.0, 1.5, 2.5])
    theory = [oscillator.spectral_radius(method, w, kept**w) for w in steps]
    np.testing.assert_allclose(stability.measured_growth(method, steps, kept), theory, rtol=1e-11)


@pytest.mark.parametrize(
    ("method", "limit"),
    [("explicit-euler", 0.0), ("semi-implicit-euler", 2.0), ("umbra", 2.0), ("rk4", math.sqrt(8))],
)
def test_the_limit_of_stability(method: str, limit: float) -> None:
    assert stability.largest_stable_step(method) == pytest.approx(limit, abs=0.01)


# Backward error analysis ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", backward_error.PREDICTIONS)
def test_prediction_and_measurement_agree_within_a_percent(method: str) -> None:
    found = backward_error.compare(load_scenario("spring"), method)
    assert found.energy_mismatch < 0.01
    assert found.shift_mismatch < 0.01
    assert found.growth_mismatch < 0.01


def test_a_wrong_prediction_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    umbra = backward_error.PREDICTIONS["umbra"]
    better = backward_error.PREDICTIONS["semi-implicit-euler"]._replace(step=umbra.step)
    monkeypatch.setitem(backward_error.PREDICTIONS, "umbra", better)
    assert backward_error.compare(load_scenario("spring"), "umbra").energy_mismatch > 0.3


# Symplecticity -------------------------------------------------------------------------------------


def test_semi_implicit_euler_is_symplectic_on_an_orbit(orbit: Reference) -> None:
    defect = symplectic.symplectic_defect(
        load_scenario("orbit_eccentric"), orbit, "semi-implicit-euler"
    )
    assert defect.as_read < symplectic.ROUNDING
    assert defect.whole_determinant == pytest.approx(1.0, abs=1e-12)


def test_explicit_euler_is_not(orbit: Reference) -> None:
    defect = symplectic.symplectic_defect(load_scenario("orbit_eccentric"), orbit, "explicit-euler")
    assert defect.as_read > 1e-4


def test_umbra_is_symplectic_half_a_kick_later_only(orbit: Reference) -> None:
    defect = symplectic.symplectic_defect(load_scenario("orbit_eccentric"), orbit, "umbra")
    assert defect.half_a_kick_later < symplectic.ROUNDING
    assert defect.as_read > 1e-5
    assert defect.whole_determinant == 0.0


# Identity, rounding, the repair ---------------------------------------------------------------------


def test_umbra_and_semi_implicit_euler_are_one_method(orbit: Reference) -> None:
    scenario = load_scenario("orbit_eccentric")
    assert undamped(scenario)
    assert distance(scenario, orbit, "umbra", "semi-implicit-euler").of_error < 1e-9
    assert distance(scenario, orbit, "umbra", "velocity-verlet").of_error > 0.1


@pytest.mark.parametrize("name", ["spring_damped", "spring_dashpot"])
def test_what_reads_the_velocity_is_not_undamped(name: str) -> None:
    assert not undamped(load_scenario(name))


@pytest.mark.parametrize(
    ("power", "law"), [(0.5, "random walk"), (1.0, "linear"), (2.0, "quadratic")]
)
def test_a_power_of_time_is_recognised(power: float, law: str) -> None:
    times = np.geomspace(1.0, 1e4, 30)
    exponent = _exponent(times, 3e-7 * times**power)
    assert exponent == pytest.approx(power, abs=1e-9)
    assert kind_of_growth(exponent) == law


def test_no_law_is_read_from_nothing() -> None:
    assert kind_of_growth(_exponent(np.arange(1.0, 9.0), np.zeros(8))) == "none"


def test_in_float32_shorter_steps_end_up_worse() -> None:
    scenario = load_scenario("free_fall")
    turn = turning_point(scenario, certified_reference(scenario), "umbra")
    assert turn.turned
    assert turn.errors[-1] > 10 * turn.errors.min()
    assert turn.steps[-1] < turn.best_step < turn.steps[0]


@pytest.mark.parametrize("method", VARIANTS)
def test_the_repair_asks_for_no_more_than_the_published_pipeline(method: str) -> None:
    scenario = load_scenario("spring")
    assert _force_evaluations(scenario, method) == 1
    assert _numbers(scenario, method) == _numbers(scenario, "umbra")


def test_counting_forces_counts() -> None:
    assert _force_evaluations(load_scenario("spring"), "rk4") == 4
