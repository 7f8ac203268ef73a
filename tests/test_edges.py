"""Physics at the edge: each odd case has an outcome, stated in docs/reliability.md."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from problems import Table, problem, spring

from umbra_bench.errors import UmbraBenchError, UnsupportedScenario
from umbra_bench.gate import Judgement, exit_code
from umbra_bench.reference import certified_reference
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import Trajectory, simulate
from umbra_bench.study import run_study

METHODS = ("semi-implicit-euler", "umbra", "umbra-repaired", "rk4")
PRECISIONS = ("float64", "float32")


def finite(run: Trajectory) -> bool:
    return bool(np.isfinite(run.position).all() and np.isfinite(run.velocity).all())


def between(first: Table, second: Table, **force: object) -> Scenario:
    """Two bodies and a spring between them."""
    pull = {"kind": "spring", "body": "body_0", "other": "body_1", "stiffness": 10.0, **force}
    return problem(first, second, forces=[pull])


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method", METHODS)
def test_coincident_bodies_on_a_spring_without_rest_length_stay(
    method: str, precision: str
) -> None:
    run = simulate(between({}, {}), method, steps=50, precision=precision)
    assert run.diverged_at is None
    assert not run.position.any()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method", METHODS)
def test_a_spring_of_no_length_with_a_rest_length_pushes_nowhere(
    method: str, precision: str
) -> None:
    """It has no direction, so it exerts no force: the bodies stay, and nothing is NaN."""
    run = simulate(
        between({}, {}, rest_length=1.0, damping=0.5), method, steps=50, precision=precision
    )
    assert run.diverged_at is None
    assert not run.position.any()
    assert run.at.energy == pytest.approx(0.5 * 10.0 * 1.0**2, rel=1e-6)


def test_its_reference_stays_as_well() -> None:
    reference = certified_reference(between({}, {}, rest_length=1.0))
    assert not reference.position.any()


def test_bodies_that_fall_into_each_other_have_no_reference() -> None:
    bodies = ({"position": [-1.0, 0.0]}, {"position": [1.0, 0.0]})
    pull = {"kind": "mutual_gravity", "bodies": ["body_0", "body_1"], "gravitational_constant": 1.0}
    with pytest.raises(UmbraBenchError, match="without collisions or singularities"):
        certified_reference(problem(*bodies, forces=[pull]))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method", METHODS)
def test_a_step_beyond_stability_diverges_and_says_when(method: str, precision: str) -> None:
    """omega dt = 20: every explicit method blows up, whose energy is not finite from some step on."""
    swinging = spring((1.1, 0.3), (-0.4, 0.9))
    run = simulate(swinging, method, 10.0, steps=4000, every=4, precision=precision)
    assert run.diverged_at is not None
    first = int(np.argmin(np.isfinite(run.position).all(axis=(1, 2)) & np.isfinite(run.at.energy)))
    assert first > 0
    assert run.diverged_at <= run.times[first]


def test_a_divergence_is_a_row_of_a_study_and_has_no_order() -> None:
    swinging = spring((1.1, 0.3), (-0.4, 0.9), duration=100.0, dt={"start": 10.0, "halvings": 1})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = run_study([swinging], ["umbra"], ["float32", "float64"])
    assert found.runs["diverged_at"].is_not_null().all()
    assert not found.orders["order"].is_finite().any()
    assert (found.runs["energy_error_max"] > 1.0).all()


def test_not_a_number_is_never_judged_good() -> None:
    for value in (math.nan, math.inf):
        judged = [Judgement("a/b/float64/0.01", "energy_error_max", 1.0, value, 1.1, "fail")]
        assert exit_code(judged) == 1


@pytest.mark.parametrize("method", METHODS)
def test_overflow_in_float32_alone(method: str) -> None:
    """A speed of 1e25 m/s has an energy of 5e49 J: float64 holds it, float32 does not."""
    fast = problem({"velocity": [1e25, 0.0]})
    wide = simulate(fast, method, steps=10)
    narrow = simulate(fast, method, steps=10, precision="float32")
    assert wide.diverged_at is None
    assert finite(wide)
    assert narrow.diverged_at == 0.0


def test_a_number_that_float32_does_not_hold_is_refused_there_alone() -> None:
    heavy = problem({"mass": 1e50})
    force = problem({}, forces=[{"kind": "constant_torque", "body": "body_0", "torque": 1e50}])
    for scenario in (heavy, force):
        assert simulate(scenario, "umbra", steps=2).diverged_at is None
        with pytest.raises(UnsupportedScenario, match="float32 does not"):
            simulate(scenario, "umbra", steps=2, precision="float32")
        skipped = run_study([scenario], ["umbra"], ["float32"]).skips
        assert "float32 does not" in skipped["reason"][0]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("method", METHODS)
def test_denormals_are_rounded_to_nothing_worse_than_zero(method: str, precision: str) -> None:
    """Numbers below the smallest normal one: the result is finite and no larger than they are."""
    tiny = float(np.finfo(precision).tiny)
    slow = spring((tiny / 8, 0.0), (0.0, tiny / 16))
    run = simulate(slow, method, steps=100, precision=precision)
    assert run.diverged_at is None
    assert np.abs(run.position).max() <= tiny


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("angle", [1e6, -1e6])
def test_an_angle_of_a_million_radians(method: str, angle: float) -> None:
    """float64 still tells 1e-10 rad there: the motion is that of the angle brought into (-pi, pi]."""
    shape = {"kind": "box", "width": 1.0, "height": 0.5}
    twist = {"kind": "torsion_spring", "body": "body_0", "stiffness": 3.0, "rest_angle": 0.4}
    near = math.remainder(angle, 2 * math.pi)
    far_run, near_run = (
        simulate(problem({"angle": a, "shape": shape}, forces=[twist]), method, steps=200)
        for a in (angle, near)
    )
    apart = (
        np.remainder(far_run.position[:, 2] - near_run.position[:, 2] + np.pi, 2 * np.pi) - np.pi
    )
    assert np.abs(apart).max() < 1e-7
    assert np.abs(far_run.velocity - near_run.velocity).max() < 1e-7


@pytest.mark.parametrize("method", METHODS)
def test_masses_twenty_orders_apart(method: str) -> None:
    """The light one swings about the heavy one, which no float64 sees move."""
    heavy, light = {"mass": 1e10}, {"mass": 1e-10, "position": [1.0, 0.0]}
    pair = between(heavy, light, stiffness=4e-10)
    alone = problem(
        light,
        forces=[{"kind": "spring", "body": "body_0", "anchor": [0.0, 0.0], "stiffness": 4e-10}],
    )
    both, one = simulate(pair, method, steps=300), simulate(alone, method, steps=300)
    assert both.diverged_at is None
    assert np.abs(both.position[:, :, 1] - one.position[:, :, 0]).max() < 1e-12
    assert np.abs(both.position[:, :, 0]).max() < 1e-18


def test_a_scenario_at_rest_is_measured_in_si_units_and_is_exact() -> None:
    still = problem({}, dt={"start": 0.5, "halvings": 3})
    reference = certified_reference(still)
    assert set(reference.scales) == {1.0}
    found = run_study([still], ["umbra", "rk4"])
    for column in (
        "position_error_max",
        "velocity_error_max",
        "energy_error_max",
        "energy_drift_rate",
    ):
        assert (found.runs[column] == 0.0).all()
    assert not found.orders["order"].is_finite().any()
    assert found.runs["diverged_at"].is_null().all()
