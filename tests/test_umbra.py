"""The engine of the devlog, part 1: the published pipeline through both of its doors."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from problems import EPS, EPS32, angles_apart, orbit, problem, spring

from umbra_bench.jax_settings import float64_allowed
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import simulate
from umbra_bench.system import body_definition, build_system
from umbra_bench.umbra import (
    Bodies,
    BodyDefinition,
    PhysicsService,
    UmbraState,
    apply_damping,
    box_inertia,
    disk_inertia,
    integrate_velocities,
    step,
)

TWO_PI = 2.0 * math.pi

# The golden recordings ----------------------------------------------------------------------------

FALL = problem(
    {"mass": 3.0, "position": [0.0, 100.0], "velocity": [2.0, 0.0]}, gravity=[0.0, -9.81]
)
SPIN = problem({"inertia": 0.5, "angle": 0.1, "angular_velocity": -12.5})
RECORDED = {
    "spring": spring((1.0, 0.0), (0.0, 0.0)),
    "orbit": orbit((0.5, 0.0), (0.0, 1.7320508)),
    "fall": FALL,
    "spin": SPIN,
}

recordings = pytest.mark.parametrize("name", RECORDED)
both_precisions = pytest.mark.parametrize(
    ("precision", "rounding"),
    [("float64", EPS), ("float32", EPS32)],
    ids=["float64", "float32"],
)


def recording(golden: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times, shape (11,), and x, y, angle, vx, vy, omega, shape (11, 6)."""
    table = np.loadtxt(golden / f"umbra-cpp-{name}.csv", delimiter=",", skiprows=1)
    return table[:, 0], table[:, 2:]


def assert_recorded(rows: np.ndarray, recorded: np.ndarray) -> None:
    """Agree to 2e-5 of the largest value of each column, as the recordings' README allows."""
    for column, truth in zip(rows.T, recorded.T, strict=True):
        largest = np.abs(truth).max()
        if largest == 0.0:
            assert np.all(column == 0.0)
        else:
            np.testing.assert_allclose(column, truth, rtol=0, atol=2e-5 * largest)


def game_spring(service: PhysicsService, body: int) -> None:
    x, y = service.read(body).position
    service.apply_force(body, (-8.0 * x, -8.0 * y))


def game_orbit(service: PhysicsService, body: int) -> None:
    x, y = service.read(body).position
    cube = math.hypot(x, y) ** 3
    service.apply_force(body, (-x / cube, -y / cube))


def game_nothing(service: PhysicsService, body: int) -> None:
    """Gravity and inertia are the engine's own."""


GAMES: dict[str, Callable[[PhysicsService, int], None]] = {
    "spring": game_spring,
    "orbit": game_orbit,
    "fall": game_nothing,
    "spin": game_nothing,
}


def service_of(scenario: Scenario, precision: str = "float32") -> PhysicsService:
    """A service with the bodies of a scenario."""
    service = PhysicsService(scenario.gravity, precision)
    for body in scenario.bodies:
        service.create_body(body_definition(body, scenario))
    return service


def row(service: PhysicsService, body: int) -> tuple[float, ...]:
    state = service.read(body)
    return (*state.position, state.angle, *state.velocity, state.angular_velocity)


@recordings
def test_the_compiled_loop_reproduces_the_recordings(golden: Path, name: str) -> None:
    times, recorded = recording(golden, name)
    run = simulate(RECORDED[name], "umbra", 0.01, precision="float32", every=50)
    rows = np.concatenate([run.position[:, :, 0], run.velocity[:, :, 0]], axis=1)
    np.testing.assert_allclose(run.times, times, rtol=4 * EPS)
    assert_recorded(rows, recorded)


@recordings
def test_a_game_that_steps_the_service_reproduces_the_recordings(golden: Path, name: str) -> None:
    _, recorded = recording(golden, name)
    service = service_of(RECORDED[name])
    rows = [row(service, 0)]
    for frame in range(1, 501):
        GAMES[name](service, 0)
        service.step()
        if frame % 50 == 0:
            rows.append(row(service, 0))
    assert_recorded(np.array(rows), recorded)


# One physics behind two doors ---------------------------------------------------------------------


@both_precisions
def test_service_and_compiled_loop_are_one_physics(precision: str, rounding: float) -> None:
    scenario = problem(
        {
            "mass": 2.0,
            "shape": {"kind": "box", "width": 1.0, "height": 0.5},
            "angle": 0.4,
            "velocity": [0.2, 0.5],
            "angular_velocity": -0.3,
            "linear_damping": 0.8,
            "angular_damping": 0.6,
        },
        {"mass": 0.5, "position": [1.0, 2.0], "affected_by_gravity": False},
        {"kind": "kinematic", "position": [-1.0, 0.0], "velocity": [0.3, 0.0]},
        forces=[
            {"kind": "spring", "body": "body_0", "other": "body_2", "stiffness": 7.0,
             "rest_length": 0.6, "point": [0.3, 0.1]},
            {"kind": "constant_force", "body": "body_1", "force": [0.4, -0.2]},
            {"kind": "constant_torque", "body": "body_1", "torque": 0.7},
        ],
        gravity=[0.5, -9.81],
    )  # fmt: skip
    steps = 200
    run = simulate(scenario, "umbra", 0.01, steps=steps, precision=precision)
    service = service_of(scenario, precision)
    forces = build_system(scenario.model_copy(update={"gravity": (0.0, 0.0)}), precision)
    rows = [[row(service, body) for body in range(3)]]
    for _ in range(steps):
        seen = np.array(rows[-1], precision).T
        for body, (fx, fy, torque) in enumerate(forces.force(seen[:3], seen[3:]).T):
            service.apply_force(body, (fx, fy))
            service.apply_torque(body, torque)
        service.step(0.01)
        rows.append([row(service, body) for body in range(3)])
    by_hand = np.array(rows).transpose(0, 2, 1)
    # Each of n steps rounds a few times, and an error of a velocity grows with n in the position.
    scale = np.abs(by_hand).max()
    np.testing.assert_allclose(by_hand[:, 3:], run.velocity, rtol=0, atol=steps * rounding * scale)
    np.testing.assert_allclose(
        by_hand[:, :2], run.position[:, :2], rtol=0, atol=steps * rounding * scale
    )
    apart = angles_apart(by_hand[:, 2], run.position[:, 2].astype(float))
    assert np.abs(apart).max() <= steps * rounding * scale


def test_defaults_are_those_of_the_engine() -> None:
    unsaid, said = PhysicsService(), PhysicsService((0.0, 0.0), "float32")
    for service in (unsaid, said):
        service.create_body(BodyDefinition(position=(0.1, 0.2), velocity=(0.3, -0.7)))
    assert unsaid.read(0).position[0] == float(np.float32(0.1)) != 0.1
    unsaid.step()
    said.step(0.01)
    assert unsaid.read(0) == said.read(0)


# Bodies -------------------------------------------------------------------------------------------


def test_inertia_of_shapes() -> None:
    assert disk_inertia(3.0, 0.5) == pytest.approx(3.0 * 0.5**2 / 2, rel=4 * EPS)
    assert box_inertia(3.0, 2.0, 0.5) == pytest.approx(3.0 * (2.0**2 + 0.5**2) / 12, rel=4 * EPS)


@pytest.mark.parametrize(
    ("definition", "inertia"),
    [
        (BodyDefinition(mass=4.0, disk_radius=0.5), 0.5),
        (BodyDefinition(mass=6.0, box=(1.0, 0.5)), 0.625),
        (BodyDefinition(mass=4.0), 4.0),
        (BodyDefinition(mass=4.0, disk_radius=0.5, inertia=0.2), 0.2),
    ],
    ids=["disk", "box", "no shape: 1.0 x mass", "given"],
)
def test_inertia_is_computed_when_absent_and_torque_turns_against_it(
    definition: BodyDefinition, inertia: float
) -> None:
    assert definition.moment_of_inertia == pytest.approx(inertia, rel=4 * EPS)
    service = PhysicsService(precision="float64")
    body = service.create_body(definition)
    service.apply_torque(body, 3.0)
    service.step(0.1)
    # The first frame averages alpha = torque / I with a stored acceleration of zero.
    expected = 0.5 * 3.0 / inertia * 0.1
    assert service.read(body).angular_velocity == pytest.approx(expected, rel=8 * EPS)


def push_in_every_way(service: PhysicsService, body: int) -> None:
    service.apply_force(body, (50.0, -20.0))
    service.apply_force_at_point(body, (10.0, 30.0), (4.0, 4.0))
    service.apply_torque(body, 5.0)
    service.apply_impulse(body, (3.0, 1.0))
    service.apply_impulse_at_point(body, (-2.0, 6.0), (-3.0, 1.0))


def test_a_kinematic_body_moves_by_its_velocity_and_by_nothing_else() -> None:
    service = PhysicsService((0.0, -9.81), "float64")
    body = service.create_body(
        BodyDefinition(
            position=(1.0, 2.0), velocity=(0.5, -0.25), angular_velocity=0.125,
            kind="kinematic", linear_damping=0.3, angular_damping=0.3,
        )
    )  # fmt: skip
    frames, dt = 100, 1 / 128  # a binary fraction: every sum below is exact
    for _ in range(frames):
        push_in_every_way(service, body)
        service.step(dt)
    t = frames * dt
    assert row(service, body) == (1 + 0.5 * t, 2 - 0.25 * t, 0.125 * t, 0.5, -0.25, 0.125)


@pytest.mark.parametrize(
    "definition",
    [BodyDefinition(kind="static", position=(1.0, 2.0), angle=0.5), BodyDefinition(mass=0.0)],
    ids=["static", "mass 0"],
)
def test_a_static_body_stays(definition: BodyDefinition) -> None:
    service = PhysicsService((0.0, -9.81))
    body = service.create_body(definition)
    before = row(service, body)
    for _ in range(10):
        push_in_every_way(service, body)
        service.step()
    assert row(service, body) == before


def test_a_sleeping_body_stays_and_a_woken_one_falls_from_rest() -> None:
    service = PhysicsService((0.0, -9.81), "float64")
    sleeper = service.create_body(
        BodyDefinition(position=(1.0, 2.0), velocity=(3.0, 4.0), angular_velocity=1.0)
    )
    service.step()
    service.sleep(sleeper)
    place = row(service, sleeper)[:3]
    for _ in range(10):
        push_in_every_way(service, sleeper)
        service.step()
    assert row(service, sleeper) == (*place, 0.0, 0.0, 0.0)
    service.wake(sleeper)
    fresh = service.create_body(BodyDefinition(position=place[:2], angle=place[2]))
    for _ in range(10):
        service.step()
    # Nothing that was done to it in its sleep is left over: it falls as one that was just made.
    assert row(service, sleeper) == row(service, fresh)
    assert service.read(sleeper).velocity[1] < 0.0


def test_a_dynamic_body_obeys_newtons_second_law() -> None:
    service = PhysicsService(precision="float64")
    body = service.create_body(BodyDefinition(mass=5.0))
    for _ in range(100):
        service.apply_force(body, (10.0, -5.0))
        service.step(0.01)
    # v = a (t - dt/2): the first frame averages with a stored acceleration of zero.
    np.testing.assert_allclose(service.read(body).velocity, (1.99, -0.995), rtol=100 * EPS)


# Gravity ------------------------------------------------------------------------------------------


@given(st.floats(2.0**-20, 2.0**20, width=32))
def test_all_masses_fall_alike(mass: float) -> None:
    service = PhysicsService((1.5, -9.81))
    body = service.create_body(BodyDefinition(mass=mass))
    for _ in range(20):
        service.step()
    # a = (m g) (1/m): three roundings, then one or two at each of 20 additions.
    expected = np.array([1.5, -9.81]) * (20 - 0.5) * 0.01
    np.testing.assert_allclose(service.read(body).velocity, expected, rtol=40 * EPS32)


def test_gravity_has_a_flag_for_each_body() -> None:
    service = PhysicsService((0.0, -9.81))
    balloon = service.create_body(BodyDefinition(position=(0.0, 5.0), affected_by_gravity=False))
    stone = service.create_body(BodyDefinition(position=(1.0, 5.0)))
    for _ in range(10):
        service.step()
    assert service.read(balloon).position == (0.0, 5.0)
    assert service.read(balloon).velocity == (0.0, 0.0)
    assert service.read(stone).position[1] < 5.0


def test_gravity_passes_through_the_accumulator() -> None:
    service = PhysicsService((0.0, -10.0), "float64")
    body = service.create_body(BodyDefinition(mass=2.0))
    for _ in range(10):
        service.apply_force(body, (0.0, 20.0))  # m g upwards: the two cancel exactly
        service.step()
    assert row(service, body) == (0.0,) * 6


# Damping ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("dt", "published"), [(0.01, 0.99975), (0.02, 0.99949)])
def test_damping_factors_of_the_devlog(dt: float, published: float) -> None:
    factor = apply_damping(np.array([1.0]), np.array([0.975]), dt)[0]
    assert factor == pytest.approx(published, rel=0, abs=5e-6)  # as many digits as it prints


@both_precisions
@pytest.mark.parametrize("steps", [1, 10, 50, 100, 1000])
def test_damping_does_not_depend_on_the_frame_rate(
    steps: int, precision: str, rounding: float
) -> None:
    service = PhysicsService(precision=precision)
    damped = service.create_body(
        BodyDefinition(
            velocity=(3.0, -4.0), angular_velocity=2.0, linear_damping=0.7, angular_damping=0.2
        )
    )
    free = service.create_body(BodyDefinition(velocity=(3.0, -4.0), angular_velocity=2.0))
    for _ in range(steps):
        service.step(1.0 / steps)
    expected = (3.0 * 0.7, -4.0 * 0.7, 2.0 * 0.2)
    # d^dt and its product round once each a step, and d itself rounds: 2 n + 2 half units.
    np.testing.assert_allclose(row(service, damped)[3:], expected, rtol=2 * (steps + 1) * rounding)
    assert row(service, free)[3:] == (3.0, -4.0, 2.0)


def test_a_body_overrides_the_scenarios_damping() -> None:
    scenario = problem(
        {"velocity": [1.0, 2.0], "angular_velocity": 3.0},
        {"velocity": [1.0, 2.0], "angular_velocity": 3.0, "linear_damping": 0.1},
        {"velocity": [1.0, 2.0], "angular_velocity": 3.0, "angular_damping": 1.0},
        duration=1.0,
        linear_damping=0.5,
        angular_damping=0.25,
    )
    end = simulate(scenario, "umbra", 0.01).velocity[-1]
    kept = np.array([[0.5, 0.1, 0.5], [0.5, 0.1, 0.5], [0.25, 0.25, 1.0]])
    start = np.array([[1.0], [2.0], [3.0]])
    np.testing.assert_allclose(end, kept * start, rtol=2 * 101 * EPS)  # two roundings a step


# Angles -------------------------------------------------------------------------------------------


def finite(width: int) -> st.SearchStrategy[float]:
    return st.floats(allow_nan=False, allow_infinity=False, width=width)  # type: ignore[arg-type]


def assert_wrapped(angle: float, omega: float, precision: str) -> None:
    dtype = np.dtype(precision).type
    with np.errstate(over="ignore"):
        assume(np.isfinite(dtype(angle) + dtype(omega) * dtype(0.01)))
    service = PhysicsService(precision=precision)
    body = service.create_body(BodyDefinition(angle=angle, angular_velocity=omega))
    service.step()
    assert 0.0 <= service.read(body).angle < TWO_PI


@given(finite(32), finite(32))
@example(-1e-30, 0.0)
@example(-1e-45, 0.0)
@example(-1e-8, 0.0)
@example(-0.0, -1e-6)
@example(6.2831850051879883, 0.0)
@example(6.2831854820251465, 0.0)
@example(1e6, 0.0)
@example(-1e6, 1e6)
@example(3.4028234663852886e38, 0.0)
def test_angles_end_in_one_turn_in_float32(angle: float, omega: float) -> None:
    assert_wrapped(angle, omega, "float32")


@given(finite(64), finite(64))
@example(-1e-30, 0.0)
@example(-5e-324, 0.0)
@example(-1e-16, 0.0)
@example(TWO_PI, 0.0)
@example(math.nextafter(TWO_PI, 0.0), 0.0)
@example(1e6, 0.0)
@example(-1e6, 1e6)
@example(1.7976931348623157e308, 0.0)
def test_angles_end_in_one_turn_in_float64(angle: float, omega: float) -> None:
    assert_wrapped(angle, omega, "float64")


SEEDED = np.random.default_rng(0)
ANGLES = np.concatenate(
    [
        SEEDED.uniform(-1e3, 1e3, 2000),
        *(sign * 10.0 ** SEEDED.uniform(-44, 37, 2000) for sign in (1.0, -1.0)),
        np.arange(-500, 500) * TWO_PI,
        np.nextafter(np.arange(-500, 500) * TWO_PI, -np.inf),
    ]
)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_compiled_code_wraps_angles_too(precision: str) -> None:
    angles = ANGLES.astype(precision)
    rows = np.stack([angles, angles, angles])
    still = np.zeros_like(rows)
    with float64_allowed():
        moved = jax.jit(integrate_velocities)(rows, still, still, angles.dtype.type(0.01))
    wrapped = np.asarray(moved)[2].astype(float)
    assert wrapped.min() >= 0.0
    assert wrapped.max() < TWO_PI


@pytest.mark.parametrize(
    ("precision", "error_of_two_pi"),
    [("float32", 1.75e-7), ("float64", 2.5e-16)],
    ids=["float32", "float64"],
)
def test_a_wrapped_angle_points_where_the_angle_did(precision: str, error_of_two_pi: float) -> None:
    angles = ANGLES[np.abs(ANGLES) <= 1e3].astype(precision)
    rows = np.stack([angles, angles, angles])
    still = np.zeros_like(rows)
    wrapped = integrate_velocities(rows, still, still, angles.dtype.type(0.01))[2]
    apart = np.abs(angles_apart(wrapped.astype(float), angles.astype(float)))
    # The rounded 2 pi is a little off at each of the turns taken off; the difference rounds, too.
    turns = np.abs(angles.astype(float)) / TWO_PI + 1
    rounding = np.finfo(precision).eps * (np.abs(angles) + TWO_PI) + 4 * EPS * np.abs(angles)
    assert np.all(apart <= turns * error_of_two_pi + rounding)


# Forces and impulses ------------------------------------------------------------------------------


def test_a_force_lasts_one_frame() -> None:
    definition = BodyDefinition(mass=2.0)
    bodies = Bodies.of([definition], np.float64)
    state = UmbraState.of([definition], np.float64)
    pushed = state._replace(force=np.array([[8.0], [-4.0], [2.0]]))
    after = step(bodies, pushed, np.float64(0.25))
    assert np.all(after.force == 0.0)
    # The published average spreads it over two frames; then the velocity is F dt / m and stays so.
    for _ in range(3):
        after = step(bodies, after, np.float64(0.25))
        np.testing.assert_array_equal(after.velocity[:, 0], [1.0, -0.5, 0.25])


def test_the_service_clears_its_accumulators() -> None:
    service = PhysicsService(precision="float64")
    body = service.create_body(BodyDefinition(mass=2.0))
    push_in_every_way(service, body)
    service.step()
    service.step()
    settled = row(service, body)[3:]
    service.step()
    assert row(service, body)[3:] == settled


def test_forces_of_one_frame_add_up() -> None:
    together, apart = PhysicsService(precision="float64"), PhysicsService(precision="float64")
    for service in (together, apart):
        service.create_body(BodyDefinition(mass=2.0))
    together.apply_force(0, (3.0, 1.0))
    apart.apply_force(0, (1.0, 4.0))
    apart.apply_force(0, (2.0, -3.0))
    for service in (together, apart):
        service.step()
    assert together.read(0) == apart.read(0)


def test_an_impulse_changes_the_velocity_at_once() -> None:
    service = PhysicsService(precision="float64")
    body = service.create_body(
        BodyDefinition(mass=4.0, inertia=0.5, position=(1.0, 2.0), velocity=(0.5, 0.25))
    )
    service.apply_impulse(body, (2.0, -6.0))
    assert row(service, body) == (1.0, 2.0, 0.0, 1.0, -1.25, 0.0)  # J/m, before any step
    service.apply_impulse_at_point(body, (0.0, 2.0), (1.5, 2.0))
    assert row(service, body) == (1.0, 2.0, 0.0, 1.0, -0.75, 2.0)  # (r x J)/I = 0.5 x 2 / 0.5
    service.step(0.5)
    assert row(service, body) == (1.5, 1.625, 1.0, 1.0, -0.75, 2.0)  # and no force is left over


coordinate = st.floats(-100.0, 100.0)
vector = st.tuples(coordinate, coordinate)


@given(force=vector, arm=vector, centre=vector)
def test_a_force_at_a_point_is_the_force_and_the_torque_r_x_f(
    force: tuple[float, float], arm: tuple[float, float], centre: tuple[float, float]
) -> None:
    point = (centre[0] + arm[0], centre[1] + arm[1])
    rx, ry = point[0] - centre[0], point[1] - centre[1]
    held, split = PhysicsService(precision="float64"), PhysicsService(precision="float64")
    for service in (held, split):
        service.create_body(BodyDefinition(mass=2.0, inertia=3.0, position=centre))
    held.apply_force_at_point(0, force, point)
    split.apply_force(0, force)
    split.apply_torque(0, rx * force[1] - ry * force[0])
    for service in (held, split):
        service.step()
    assert held.read(0) == split.read(0)  # the same sums in the same order


@given(force=vector, centre=vector)
def test_a_force_through_the_centre_does_not_turn(
    force: tuple[float, float], centre: tuple[float, float]
) -> None:
    service = PhysicsService(precision="float64")
    body = service.create_body(BodyDefinition(position=centre))
    service.apply_force_at_point(body, force, centre)
    service.apply_impulse_at_point(body, force, centre)
    service.step()
    assert service.read(body).angular_velocity == 0.0


# What is refused ----------------------------------------------------------------------------------

NAN, INF = math.nan, math.inf

REFUSED: dict[str, tuple[Callable[[PhysicsService], object], str]] = {
    "unknown handle, force": (lambda s: s.apply_force(7, (1.0, 0.0)), "body = 7"),
    "unknown handle, force at point": (
        lambda s: s.apply_force_at_point(1, (1.0, 0.0), (0.0, 0.0)),
        "body = 1",
    ),
    "unknown handle, torque": (lambda s: s.apply_torque(-1, 1.0), "body = -1"),
    "unknown handle, impulse": (lambda s: s.apply_impulse(7, (1.0, 0.0)), "body = 7"),
    "unknown handle, impulse at point": (
        lambda s: s.apply_impulse_at_point(7, (1.0, 0.0), (0.0, 0.0)),
        "body = 7",
    ),
    "unknown handle, read": (lambda s: s.read(7), "body = 7"),
    "unknown handle, sleep": (lambda s: s.sleep(7), "body = 7"),
    "unknown handle, wake": (lambda s: s.wake(7), "body = 7"),
    "handle of another kind": (lambda s: s.read("bob"), "body = 'bob'"),  # type: ignore[arg-type]
    "dt zero": (lambda s: s.step(0.0), "dt = 0.0"),
    "dt negative": (lambda s: s.step(-0.01), "dt = -0.01"),
    "dt NaN": (lambda s: s.step(NAN), "dt = nan"),
    "dt infinite": (lambda s: s.step(INF), "dt = inf"),
    "force NaN": (lambda s: s.apply_force(0, (NAN, 0.0)), "force = (nan, 0.0)"),
    "force infinite": (lambda s: s.apply_force(0, (0.0, -INF)), "force = (0.0, -inf)"),
    "force at point NaN": (
        lambda s: s.apply_force_at_point(0, (0.0, NAN), (0.0, 0.0)),
        "force = (0.0, nan)",
    ),
    "point NaN": (
        lambda s: s.apply_force_at_point(0, (1.0, 0.0), (NAN, 0.0)),
        "point = (nan, 0.0)",
    ),
    "torque infinite": (lambda s: s.apply_torque(0, INF), "torque = inf"),
    "impulse NaN": (lambda s: s.apply_impulse(0, (NAN, NAN)), "impulse = (nan, nan)"),
    "impulse at point infinite": (
        lambda s: s.apply_impulse_at_point(0, (INF, 0.0), (0.0, 0.0)),
        "impulse = (inf, 0.0)",
    ),
    "gravity NaN": (lambda s: PhysicsService((0.0, NAN)), "gravity = (0.0, nan)"),
    "precision": (lambda s: PhysicsService(precision="half"), "precision = 'half'"),
    "mass negative": (lambda s: BodyDefinition(mass=-1.5), "mass = -1.5"),
    "mass NaN": (lambda s: BodyDefinition(mass=NAN), "mass = nan"),
    "mass infinite": (lambda s: BodyDefinition(mass=INF), "mass = inf"),
    "inertia negative": (lambda s: BodyDefinition(inertia=-0.5), "inertia = -0.5"),
    "radius negative": (lambda s: BodyDefinition(disk_radius=-0.5), "disk_radius = -0.5"),
    "box of no height": (lambda s: BodyDefinition(box=(1.0, 0.0)), "box = (1.0, 0.0)"),
    "position NaN": (lambda s: BodyDefinition(position=(NAN, 0.0)), "position = (nan, 0.0)"),
    "velocity infinite": (lambda s: BodyDefinition(velocity=(0.0, INF)), "velocity = (0.0, inf)"),
    "angle NaN": (lambda s: BodyDefinition(angle=NAN), "angle = nan"),
    "angular velocity NaN": (
        lambda s: BodyDefinition(angular_velocity=NAN),
        "angular_velocity = nan",
    ),
    "kind": (lambda s: BodyDefinition(kind="ghost"), "kind = 'ghost'"),  # type: ignore[arg-type]
    "damping zero": (lambda s: BodyDefinition(linear_damping=0.0), "linear_damping = 0.0"),
    "damping above one": (
        lambda s: BodyDefinition(angular_damping=1.5),
        "angular_damping = 1.5",
    ),
    "static with a velocity": (
        lambda s: BodyDefinition(kind="static", velocity=(1.0, 0.0)),
        "velocity = (1.0, 0.0)",
    ),
    "static with a spin": (
        lambda s: BodyDefinition(kind="static", angular_velocity=2.0),
        "angular_velocity = 2.0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_wrong_is_refused_by_name_and_value(what: str) -> None:
    service = PhysicsService()
    service.create_body(BodyDefinition())
    act, words = REFUSED[what]
    with pytest.raises(ValueError, match=f"^{re.escape(words)}"):
        act(service)


def test_a_refused_push_leaves_no_trace() -> None:
    service = PhysicsService()
    body = service.create_body(BodyDefinition(position=(1.0, 2.0)))
    with pytest.raises(ValueError, match="force"):
        service.apply_force(body, (1.0, NAN))
    with pytest.raises(ValueError, match="point"):
        service.apply_force_at_point(body, (1.0, 0.0), (INF, 0.0))
    service.step()
    assert row(service, body) == (1.0, 2.0, 0.0, 0.0, 0.0, 0.0)
