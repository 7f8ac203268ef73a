"""The truth: closed forms solve the equations of motion, and the reference agrees with them."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import EPS, in_numpy, orbit, problem, spring

from umbra_bench.closed_form import CLOSED_FORMS, fitting_closed_forms, solve_closed_form
from umbra_bench.errors import UmbraBenchError
from umbra_bench.reference import (
    certified_reference,
    derivative,
    sample_times,
    solve_dop853,
    solve_reference,
)
from umbra_bench.scenario import Scenario, load_scenario

Load = Callable[[str], Scenario]

SCENARIOS = Path(__file__).resolve().parent.parent / "scenarios"
EXACT = [
    path.stem
    for path in sorted(SCENARIOS.glob("*.toml"))
    if load_scenario(path).closed_form is not None
]


# What a closed form has to satisfy ----------------------------------------------------------------

FASTEST = 150.0
"""rad/s: above every frequency here (100 of spring_stiff, 43 at the pericentre of e = 0.9)."""

H = 1e-5
"""The step of the differences, s: truncation (FASTEST H)^2/6 = 4e-7, rounding EPS/H = 2e-11."""


def assert_solves_the_equations_of_motion(scenario: Scenario) -> None:
    """dx/dt = v and dv/dt = a(x, v) + ln(d) v, by central differences at times in between."""
    system, _ = in_numpy(scenario)
    times = np.random.default_rng(1).uniform(H, scenario.duration, 200)
    position, velocity = solve_closed_form(scenario, times)
    late, early = (solve_closed_form(scenario, times + h) for h in (H, -H))
    slopes = [derivative(system, x, v) for x, v in zip(position, velocity, strict=True)]
    for quantity, values in enumerate((position, velocity)):
        found = (late[quantity] - early[quantity]) / (2 * H)
        expected = np.stack([slope[quantity] for slope in slopes])
        # A phase of up to FASTEST t rounds, too; the slopes change by FASTEST in each derivative.
        truncation = (FASTEST * H) ** 2 / 6 * np.abs(expected).max()
        phase = 1 + FASTEST * scenario.duration
        rounding = EPS / H * (np.abs(values).max() + phase * H * np.abs(expected).max())
        np.testing.assert_allclose(found, expected, rtol=0, atol=truncation + 8 * rounding)


def assert_starts_as_the_scenario(scenario: Scenario) -> None:
    _, start = in_numpy(scenario)
    position, velocity = solve_closed_form(scenario, np.zeros(1))
    for found, given_ in ((position[0], start.position), (velocity[0], start.velocity)):
        # Sums over up to 32 modes, or a division by 1 - e: some ten roundings of the largest value.
        np.testing.assert_allclose(found, given_, rtol=0, atol=64 * EPS * np.abs(given_).max())


def two_beads(**more: object) -> Scenario:
    """Two bodies on one spring and no wall: one mode swings, one drifts and falls."""
    return problem(
        {"mass": 2.0, "position": [0.3, 0.1], "velocity": [0.4, -0.2], "angular_velocity": 0.7},
        {"mass": 0.5, "position": [1.1, 0.9], "velocity": [-0.3, 0.5], "angle": 0.4},
        forces=[{"kind": "spring", "body": "body_0", "other": "body_1", "stiffness": 3.0}],
        gravity=[0.2, -1.5],
        closed_form="normal_modes",
        **more,
    )


def damped_spring(kept: float, **more: object) -> Scenario:
    """omega = 2 rad/s and the velocity damped at the rate -ln(kept); critical at 4 per second."""
    return spring((1.1, 0.3), (-0.4, 0.9), linear_damping=kept, closed_form="normal_modes", **more)


MADE = {
    "underdamped": damped_spring(0.7),
    "nearly critical": damped_spring(math.exp(-4.0)),
    "over-critical": damped_spring(1e-4),
    "far over-critical": damped_spring(1e-12),
    "free pair": two_beads(),
    "damped free pair": two_beads(linear_damping=0.4, angular_damping=0.1),
    "hanging from a static body, one more not touched by gravity": problem(
        {"kind": "static", "position": [0.5, 1.0]},
        {"mass": 0.5, "position": [0.3, 0.1], "velocity": [0.4, -0.2], "angular_velocity": 1.0},
        {"mass": 1.5, "position": [0.1, -0.7], "affected_by_gravity": False},
        forces=[
            {"kind": "spring", "body": "body_1", "other": "body_0", "stiffness": 9.0},
            {"kind": "spring", "body": "body_2", "other": "body_1", "stiffness": 4.0},
        ],
        gravity=[0.0, -9.81],
        closed_form="normal_modes",
    ),
    "damped torsion spring on a damped spring": problem(
        {"mass": 2.0, "inertia": 0.3, "angle": 0.9, "velocity": [0.2, 0.1]},
        forces=[
            {"kind": "spring", "body": "body_0", "anchor": [0.4, 0.1], "stiffness": 3.0},
            {"kind": "torsion_spring", "body": "body_0", "stiffness": 1.1, "rest_angle": 0.2},
        ],
        linear_damping=0.8,
        angular_damping=0.05,
        closed_form="normal_modes",
    ),
    "a body that never turns beside one that does": problem(
        {"mass": 2.0, "inertia": 0.0, "position": [1.0, 0.0], "angle": 0.5},
        {"mass": 0.5, "position": [0.0, 1.0], "angle": 0.4, "angular_velocity": 0.7},
        forces=[
            {"kind": "spring", "body": "body_0", "anchor": [0.4, 0.1], "stiffness": 3.0},
            {"kind": "spring", "body": "body_1", "anchor": [0.4, 0.1], "stiffness": 3.0},
        ],
        closed_form="normal_modes",
    ),
    "thrown bodies, all kinds": problem(
        {"mass": 2.0, "velocity": [3.0, 4.0], "angular_velocity": 2.0},
        {"mass": 3.0, "velocity": [1.0, 4.0], "linear_damping": 0.3, "angular_damping": 1.0},
        {"mass": 1.0, "velocity": [1.0, -2.0], "affected_by_gravity": False},
        {"kind": "kinematic", "velocity": [1.0, -2.0], "angular_velocity": -1.0},
        {"kind": "static"},
        gravity=[0.3, -9.81],
        linear_damping=0.8,
        angular_damping=0.6,
        closed_form="free_motion",
    ),
    "orbit about a centre elsewhere, clockwise and turning": problem(
        {"mass": 3.0, "position": [2.0, 1.0], "velocity": [0.4, -0.6], "angular_velocity": 0.5},
        forces=[{"kind": "central_gravity", "body": "body_0", "centre": [1.0, 0.5], "mu": 0.8}],
        closed_form="kepler",
    ),
}

projects = pytest.mark.parametrize("name", EXACT)
made = pytest.mark.parametrize("what", MADE)


@projects
def test_closed_forms_solve_the_equations_of_motion(load: Load, name: str) -> None:
    assert_solves_the_equations_of_motion(load(name))


@projects
def test_closed_forms_start_where_the_scenario_starts(load: Load, name: str) -> None:
    assert_starts_as_the_scenario(load(name))


@made
def test_closed_forms_solve_other_problems_of_their_kind(what: str) -> None:
    assert_solves_the_equations_of_motion(MADE[what])


@made
def test_closed_forms_start_where_other_problems_start(what: str) -> None:
    assert_starts_as_the_scenario(MADE[what])


@pytest.mark.parametrize("kept", [0.7, math.exp(-4.0), 1e-4])
def test_damped_modes_agree_with_an_independent_solution(kept: float) -> None:
    scenario = damped_spring(kept)
    times = sample_times(scenario)
    exact, independent = solve_closed_form(scenario, times), solve_dop853(scenario, times)
    for found, expected in zip(exact, independent, strict=True):
        # DOP853 keeps each of some hundred steps within 1e-13.
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


def test_heavy_damping_over_a_long_time_comes_to_rest() -> None:
    # The slow mode of q'' + rate q' + omega^2 q = 0 decays as omega^2/rate = 4/46 per second.
    scenario = damped_spring(1e-20, duration=40.0)
    rate = -math.log(1e-20)
    slow = rate / 2 - math.sqrt(rate**2 / 4 - 4.0)
    position, velocity = solve_closed_form(scenario, np.array([20.0, 40.0]))
    assert np.all(np.isfinite(position))
    np.testing.assert_allclose(position[1, :2], position[0, :2] * math.exp(-20 * slow), rtol=1e-9)
    np.testing.assert_allclose(velocity[1, :2], -slow * position[1, :2], rtol=1e-9)


# Kepler -------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(
    eccentricity=st.floats(0.0, 0.95),
    anomaly=st.floats(0.0, 2 * math.pi),
    orientation=st.floats(0.0, 2 * math.pi),
    axis=st.floats(0.5, 2.0),
    sense=st.sampled_from([1.0, -1.0]),
)
def test_kepler_orbits_of_any_eccentricity(
    eccentricity: float, anomaly: float, orientation: float, axis: float, sense: float
) -> None:
    minor = axis * math.sqrt(1 - eccentricity**2)
    rate = axis**-1.5 / (1 - eccentricity * math.cos(anomaly))
    c, s = math.cos(orientation), math.sin(orientation)
    turn = np.array([[c, -s * sense], [s, c * sense]])
    place = turn @ [axis * (math.cos(anomaly) - eccentricity), minor * math.sin(anomaly)]
    pace = turn @ [-axis * math.sin(anomaly) * rate, minor * math.cos(anomaly) * rate]
    revolution = 2 * math.pi * axis**1.5
    sweep = {"start": revolution / 256, "halvings": 0}
    scenario = orbit(tuple(place), tuple(pace), duration=revolution, dt=sweep, closed_form="kepler")
    times = sample_times(scenario)
    position, velocity = solve_closed_form(scenario, times)
    # DOP853 keeps each of some hundred steps within 1e-13; in a revolution an error grows by about
    # (1 - e)^-2, up to 400, in the position, and in the velocity by the pericentre's rate more.
    truth = solve_dop853(scenario, times)
    np.testing.assert_allclose(position, truth[0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(velocity, truth[1], rtol=0, atol=1e-7 / (1 - eccentricity) ** 2)
    # After one revolution it is back, up to the rounding of the axis, 1/(2/r - v^2/mu), which
    # cancels by up to 40, and the speed at which the pericentre is passed.
    np.testing.assert_allclose(position[-1], position[0], rtol=0, atol=1e-11)


# What a closed form does not solve ----------------------------------------------------------------


@pytest.mark.parametrize(
    "scenario",
    [
        orbit((1.0, 0.0), (0.0, 1.5)),
        orbit((1.0, 0.0), (0.5, 0.0)),
        orbit((1.0, 0.0), (0.0, 1.0), linear_damping=0.9),
        orbit((1.0, 0.0), (0.0, 1.0), gravity=[0.0, -1.0]),
        problem(
            {},
            forces=[
                {"kind": "spring", "body": "body_0", "anchor": [1.0, 0.0], "stiffness": 1.0,
                 "rest_length": 0.5}
            ],
        ),
        problem(
            {"angle": 3.0, "angular_velocity": 1.0},
            forces=[{"kind": "torsion_spring", "body": "body_0", "stiffness": 1.0}],
        ),
    ],
    ids=["hyperbola", "plunge", "damped orbit", "falling orbit", "rest length", "past half a turn"],
)  # fmt: skip
def test_no_closed_form_claims_what_it_does_not_solve(scenario: Scenario) -> None:
    assert fitting_closed_forms(scenario) == []


# The reference ------------------------------------------------------------------------------------


@projects
def test_the_reference_agrees_with_the_closed_form(load: Load, name: str) -> None:
    certificate = certified_reference(load(name)).certificate
    assert certificate.independent == load(name).closed_form
    assert certificate.independent_difference <= 1e-10


def test_every_closed_form_is_tried(load: Load) -> None:
    assert {load(name).closed_form for name in EXACT} == set(CLOSED_FORMS)


def test_the_reference_fails_on_a_head_on_collision() -> None:
    # From rest at 1 m with mu = 1 m^3/s^2 the centre is reached after pi/(2 sqrt 2) = 1.1 s.
    # (Duration and step of the orbits above, so that their compiled code serves.)
    plunge = orbit((1.0, 0.0), (0.0, 0.0), duration=20.0, dt={"start": 0.04, "halvings": 0})
    with pytest.raises(UmbraBenchError, match=r"problem: the reference did not reach t = 20\.0 s;"):
        solve_reference(plunge, sample_times(plunge))
