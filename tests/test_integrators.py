"""What is exact about each integrator: its discrete solution, what it conserves, what it equals."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import EPS, angles_apart, in_numpy, orbit, problem, spring, states, three_stars, trace

from umbra_bench.compiled import COMPILED_METHODS
from umbra_bench.integrators import INTEGRATORS
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.methods import METHODS
from umbra_bench.scenario import Scenario
from umbra_bench.simulation import simulate
from umbra_bench.state import State, angular_momentum, linear_momentum
from umbra_bench.system import System, build_system
from umbra_bench.umbra.bodies import UmbraState

Load = Callable[[str], Scenario]

SYMPLECTIC = ("semi-implicit-euler", "velocity-verlet", "yoshida4", "umbra-repaired")
ALL = tuple(name for name in COMPILED_METHODS if METHODS[name].studied)

# The exact discrete solution of the spring --------------------------------------------------------

OMEGA, SQUARE = 2.0, 4.0
"""Of the spring of `problems`: rad/s, and its square."""


def verlet_matrix(h: float) -> np.ndarray:
    """x += v h + a h^2/2; v += (a_old + a_new) h/2, with a = -omega^2 x."""
    diagonal = 1 - SQUARE * h**2 / 2
    return np.array([[diagonal, h], [-SQUARE * h * (1 - SQUARE * h**2 / 4), diagonal]])


def taylor_matrix(h: float) -> np.ndarray:
    """exp(A h) up to the fourth power: every Runge-Kutta method of order 4 in 4 stages."""
    generator = h * np.array([[0.0, 1.0], [-SQUARE, 0.0]])
    total, power = np.eye(2), np.eye(2)
    for k in range(1, 5):
        power = power @ generator / k
        total = total + power
    return total


def yoshida_matrix(h: float) -> np.ndarray:
    cube_root = 2.0 ** (1 / 3)
    outer, inner = 1 / (2 - cube_root), -cube_root / (2 - cube_root)
    return verlet_matrix(outer * h) @ verlet_matrix(inner * h) @ verlet_matrix(outer * h)


def umbra_matrix(h: float) -> np.ndarray:
    """On (x, v, a): a' = -omega^2 x; v' = v + (a + a') h/2; x' = x + v' h + a' h^2/2."""
    acceleration = np.array([-SQUARE, 0.0, 0.0])
    velocity = np.array([0.0, 1.0, h / 2]) + acceleration * h / 2
    position = np.array([1.0, 0.0, 0.0]) + velocity * h + acceleration * h**2 / 2
    return np.stack([position, velocity, acceleration])


ONE_STEP: dict[str, Callable[[float], np.ndarray]] = {
    "explicit-euler": lambda h: np.array([[1.0, h], [-SQUARE * h, 1.0]]),
    "semi-implicit-euler": lambda h: np.array([[1 - SQUARE * h**2, h], [-SQUARE * h, 1.0]]),
    "velocity-verlet": verlet_matrix,
    "rk4": taylor_matrix,
    "yoshida4": yoshida_matrix,
    "umbra": umbra_matrix,
    "umbra-repaired": verlet_matrix,
}


@pytest.mark.parametrize("method", ALL)
def test_the_spring_follows_the_powers_of_the_one_step_matrix(method: str) -> None:
    dt, steps = 0.05, 200
    run = simulate(spring((1.1, 0.3), (-0.4, 0.9)), method, dt, steps=steps)
    matrix = ONE_STEP[method](dt)
    start = np.array([[1.1, 0.3], [-0.4, 0.9], [0.0, 0.0]])[: len(matrix)]
    exact = np.stack([np.linalg.matrix_power(matrix, n) @ start for n in range(steps + 1)])
    # A few roundings in each of n steps, of numbers as large as the largest.
    atol = 4 * steps * EPS * np.abs(exact).max()
    np.testing.assert_allclose(run.position[:, :2, 0], exact[:, 0], rtol=0, atol=atol)
    np.testing.assert_allclose(run.velocity[:, :2, 0], exact[:, 1], rtol=0, atol=atol)


# The step map and its derivative ------------------------------------------------------------------


def phase(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """z = (x, y of all bodies, then vx, vy of all bodies) of many states: shape (P, 4 N)."""
    return np.concatenate([position[:, :2], velocity[:, :2]], axis=1).reshape(len(position), -1)


@functools.partial(jax.jit, static_argnames="method")
def _jacobians(method: str, system: System, dt: jax.Array, places: jax.Array) -> jax.Array:
    start, step = COMPILED_METHODS[method]

    def rows(flat: jax.Array) -> jax.Array:
        rows = flat.reshape(2, -1)
        return jnp.stack([*rows, jnp.zeros_like(rows[0])])

    def one_step(z: jax.Array) -> jax.Array:
        x, v = jnp.split(z, 2)
        moved = step(system, start(system, State(rows(x), rows(v))), dt)
        return jnp.concatenate([moved.position[:2].ravel(), moved.velocity[:2].ravel()])

    return jax.vmap(jax.jacfwd(one_step))(places)


def jacobians(method: str, scenario: Scenario, dt: float, places: np.ndarray) -> np.ndarray:
    """The derivative of one step from a fresh start at each of the places, shape (P, 4 N, 4 N)."""
    with float64_allowed():
        return np.asarray(_jacobians(method, build_system(scenario), np.float64(dt), places))


@pytest.mark.parametrize(
    ("method", "determinant"),
    [
        ("explicit-euler", lambda z: 1 + z**2),
        ("velocity-verlet", lambda z: 1.0),
        ("rk4", lambda z: 1 - z**6 / 72 + z**8 / 576),
    ],
    ids=["explicit-euler", "velocity-verlet", "rk4"],
)
def test_determinant_of_a_step_of_the_spring(
    method: str, determinant: Callable[[float], float]
) -> None:
    """1 preserves the areas of phase space. z = omega dt."""
    dt = 0.1
    place = np.array([[1.1, 0.3, -0.4, 0.9]])
    (jacobian,) = jacobians(method, spring((1.1, 0.3), (-0.4, 0.9)), dt, place)
    # x and y are two springs: z = (x, y, vx, vy). Entries of order 1, a few roundings each.
    for row in (0, 1):
        plane = jacobian[row::2, row::2]
        assert np.linalg.det(plane) == pytest.approx(determinant(OMEGA * dt), rel=0, abs=16 * EPS)


@pytest.mark.parametrize("scenario", [spring((1.1, 0.3), (0, 0)), orbit((1.1, 0.3), (0, 0))])
def test_the_published_step_on_position_velocity_and_acceleration_is_singular(
    scenario: Scenario,
) -> None:
    system, _ = in_numpy(scenario)
    published = COMPILED_METHODS["umbra"].step

    def one_step(z: jax.Array) -> jax.Array:
        none = jnp.zeros((3, 1))
        x, v, a = (none.at[:2, 0].set(part) for part in jnp.split(z, 3))
        moved = published(system, UmbraState(x, v, a, none), np.float64(0.1))
        return jnp.concatenate([m[:2, 0] for m in moved[:3]])

    with float64_allowed():
        place = jnp.array([1.1, 0.3, -0.4, 0.9, 0.7, -0.2])
        jacobian = np.asarray(jax.jit(jax.jacfwd(one_step))(place))
    # (x, v, a) is (x, u = v + a dt/2) and no more: one direction in each of x and y is lost.
    values = np.linalg.svd(jacobian, compute_uv=False)
    assert np.linalg.det(jacobian) == pytest.approx(0.0, abs=16 * EPS)
    assert np.all(values[4:] <= 16 * EPS * values[0])
    assert np.all(values[:4] > 0.1)


KEPLER = orbit((0.5, 0.1), (-0.2, 1.5))


def canonical_jacobians(method: str, scenario: Scenario, dt: float) -> np.ndarray:
    """The derivative of a step in (x, p = m v), at five places of a motion."""
    j = jacobians(method, scenario, dt, phase(*trace("rk4", scenario, 0.05, 40))[::8])
    masses = [body.mass for body in scenario.bodies]
    scale = np.concatenate([np.ones(2 * len(masses)), masses, masses])
    return scale[:, None] * j / scale


def symplecticity_defect(j: np.ndarray) -> float:
    """The largest entry of J^T Omega J - Omega."""
    half = j.shape[1] // 2
    zero, one = np.zeros((half, half)), np.eye(half)
    omega = np.block([[zero, one], [-one, zero]])
    return float(np.abs(np.swapaxes(j, 1, 2) @ omega @ j - omega).max())


@pytest.mark.parametrize("method", SYMPLECTIC)
def test_symplectic_methods_preserve_the_symplectic_form_and_volumes(method: str) -> None:
    j = canonical_jacobians(method, three_stars(), 0.05)
    # Entries are of order 1 to 10; sums of some ten products of two of them round so much.
    assert symplecticity_defect(j) <= 1000 * EPS
    np.testing.assert_allclose(np.linalg.det(j), 1.0, rtol=0, atol=1000 * EPS)


@pytest.mark.parametrize(("method", "power"), [("explicit-euler", 2), ("rk4", 6)])
def test_the_other_methods_do_not(method: str, power: int) -> None:
    coarse, fine = (
        symplecticity_defect(canonical_jacobians(method, KEPLER, dt)) for dt in (0.02, 0.01)
    )
    # The powers are those of the determinants above; the next power of dt bends the slope a little.
    assert np.log2(coarse / fine) == pytest.approx(power, abs=0.1)


# Forces that read the velocity ---------------------------------------------------------------------


@pytest.mark.parametrize("method", ["velocity-verlet", "yoshida4"])
def test_a_kick_under_drag_is_a_polynomial_of_order_4(method: str) -> None:
    """dv/dt = -c v/m from a kick of h: v (1 - z + z^2/2 - z^3/6 + z^4/24) with z = c h/m."""
    drag = {"kind": "drag", "body": "body_0", "coefficient": 3.0}
    scenario = problem({"mass": 2.0, "velocity": [1.0, -0.5]}, forces=[drag])
    dt, outer = 0.1, 1 / (2 - 2 ** (1 / 3))
    kicks = {
        "velocity-verlet": [0.5, 0.5],
        "yoshida4": [outer / 2, (1 - outer) / 2, (1 - outer) / 2, outer / 2],
    }[method]
    z = 3.0 * dt / 2.0 * np.array(kicks)
    expected = np.prod(1 - z + z**2 / 2 - z**3 / 6 + z**4 / 24) * np.array([1.0, -0.5])
    _, velocity = trace(method, scenario, dt, 1)
    np.testing.assert_allclose(velocity[1, :2, 0], expected, rtol=32 * EPS)  # some ten roundings


@pytest.mark.parametrize(
    ("method", "order"),
    [("semi-implicit-euler", 1), ("velocity-verlet", 2), ("rk4", 4), ("yoshida4", 4)],
)
def test_orders_hold_for_forces_that_read_the_velocity(load: Load, method: str, order: int) -> None:
    scenario = load("spring_dashpot")
    ends = [trace(method, scenario, 0.04 / 2**k, 25 * 2**k)[0][-1] for k in range(4)]
    gaps = [np.abs(np.diff(pair, axis=0)).max() for pair in itertools.pairwise(ends)]
    # Gaps of successive solutions shrink by 2^order, up to the next power of dt.
    assert np.log2(gaps[1] / gaps[2]) == pytest.approx(order, abs=0.1)


# Time reversal ------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["velocity-verlet", "yoshida4", "umbra-repaired"])
@pytest.mark.parametrize("scenario", [KEPLER, three_stars()], ids=["kepler", "three stars"])
def test_symmetric_methods_return_when_time_is_reversed(method: str, scenario: Scenario) -> None:
    steps, dt = 100, 0.02
    system, state = in_numpy(scenario)
    *_, there = states(method, system, state, dt, steps)
    *_, back = states(method, system, State(there.position, there.velocity), -dt, steps)
    # Each of 2 n steps rounds, and on an orbit an error of a velocity grows with n in the position.
    for end, start in ((back.position, state.position), (back.velocity, state.velocity)):
        np.testing.assert_allclose(end[:2], start[:2], rtol=0, atol=(2 * steps) ** 2 * EPS)


def test_semi_implicit_euler_does_not_return() -> None:
    dt = 0.02
    system, state = in_numpy(KEPLER)
    *_, there = states("semi-implicit-euler", system, state, dt, 1)
    *_, back = states("semi-implicit-euler", system, there, -dt, 1)
    # x - (v' - a(x') dt) dt with x = x' - v' dt: it misses by a(x') dt^2.
    miss = system.acceleration(there.position, there.velocity) * dt**2
    np.testing.assert_allclose(back.position - state.position, miss, rtol=0, atol=4 * EPS)
    assert np.abs(miss).max() > 1e-4


# Conservation of momenta --------------------------------------------------------------------------


def momenta(method: str, scenario: Scenario, dt: float, steps: int) -> tuple[np.ndarray, ...]:
    """Linear and angular momentum after each step."""
    system, _ = in_numpy(scenario)
    seen = list(states(method, *in_numpy(scenario), dt, steps))
    linear = np.stack([linear_momentum(system.bodies, s.velocity) for s in seen])
    angular = np.stack([angular_momentum(system.bodies, *s[:2]).sum() for s in seen])
    return linear, angular


@pytest.mark.parametrize("method", ALL)
def test_every_method_conserves_linear_momentum(method: str) -> None:
    steps = 200
    linear, _ = momenta(method, three_stars(), 0.01, steps)
    # Newton's third law holds to round-off in each of n steps; momenta are of order 1.
    np.testing.assert_allclose(linear, linear[[0] * len(linear)], rtol=0, atol=steps * 4 * EPS)


@pytest.mark.parametrize("method", SYMPLECTIC)
def test_kicks_and_drifts_conserve_angular_momentum(method: str) -> None:
    steps = 200
    _, angular = momenta(method, three_stars(), 0.01, steps)
    np.testing.assert_allclose(angular, angular[0], rtol=0, atol=steps * 8 * EPS)
    assert abs(angular[0]) > 0.05


@pytest.mark.parametrize("method", ["explicit-euler", "rk4", "umbra"])
def test_the_others_do_not_conserve_angular_momentum(method: str) -> None:
    _, angular = momenta(method, three_stars(), 0.01, 200)
    assert np.ptp(angular) > 1e-12  # far above the 200 x 8 EPS = 4e-13 of the others


# Methods that are one method ----------------------------------------------------------------------

UNDAMPED = (
    "spring",
    "elastic_pendulum",
    "spring_chain",
    "orbit_eccentric",
    "free_fall",
    "thruster",
    "torsion_spring",
    "spinning_box",
)

STEPS, DT = 250, 0.01


def assert_same_motion(found: tuple[np.ndarray, ...], expected: tuple[np.ndarray, ...]) -> None:
    """Equal up to a rounding of each of n steps, which grows with n in the position."""
    apart = [f - e for f, e in zip(found, expected, strict=True)]
    apart[0][:, 2] = angles_apart(found[0][:, 2], expected[0][:, 2])
    scale = max(np.abs(e).max() for e in expected)
    for gap in apart:
        np.testing.assert_allclose(gap, 0.0, atol=STEPS**2 / 4 * EPS * scale)


@pytest.mark.parametrize("name", UNDAMPED)
def test_umbra_traces_the_positions_of_semi_implicit_euler(load: Load, name: str) -> None:
    scenario = load(name)
    published, _ = trace("umbra", scenario, DT, STEPS)
    euler, _ = trace("semi-implicit-euler", scenario, DT, STEPS)
    # u = v + a dt/2 starts as the velocity, since no acceleration is stored, and gains a dt a step.
    assert_same_motion((published,), (euler,))


@pytest.mark.parametrize("name", UNDAMPED)
def test_the_velocity_of_umbra_lags_half_a_kick(load: Load, name: str) -> None:
    scenario = load(name)
    system, _ = in_numpy(scenario)
    _, published = trace("umbra", scenario, DT, STEPS)
    position, euler = trace("semi-implicit-euler", scenario, DT, STEPS)
    kicks = [system.acceleration(x, v) * DT for x, v in zip(position, euler, strict=True)]
    assert_same_motion((published[1:],), (euler[1:] - np.stack(kicks)[:-1] / 2,))


@pytest.mark.parametrize("name", UNDAMPED)
def test_umbra_repaired_is_velocity_verlet(load: Load, name: str) -> None:
    scenario = load(name)
    repaired = trace("umbra-repaired", scenario, DT, STEPS)
    assert_same_motion(repaired, trace("velocity-verlet", scenario, DT, STEPS))


def test_errors_of_umbra_in_free_fall() -> None:
    """After t at dt, from rest: position off by g dt t/2, velocity by -g dt/2, with g < 0."""
    g, dt, t = -9.81, 0.01, 1.0
    run = simulate(problem({}, gravity=[0.0, g]), "umbra", dt, steps=100, every=100)
    position_error = run.position[-1, 1, 0] - g * t**2 / 2
    velocity_error = run.velocity[-1, 1, 0] - g * t
    # 100 steps, each a rounding of numbers up to 10.
    assert position_error == pytest.approx(g * dt * t / 2, rel=0, abs=100 * EPS * 10)
    assert velocity_error == pytest.approx(-g * dt / 2, rel=0, abs=100 * EPS * 10)
    assert position_error == pytest.approx(-0.04905, rel=1e-9)


@pytest.mark.parametrize("method", [*ALL, "pymunk", "pymunk-velocity-func"])
def test_every_method_damps_by_the_second(method: str) -> None:
    body = {"velocity": [3.0, -4.0], "angular_velocity": 2.0}
    scenario = problem(body, linear_damping=0.7, angular_damping=0.2, duration=1.0)
    for steps in (10, 100):
        run = simulate(scenario, method, 1.0 / steps, every=steps)
        # d^dt and its product round once each a step.
        expected = [3.0 * 0.7, -4.0 * 0.7, 2.0 * 0.2]
        np.testing.assert_allclose(run.velocity[-1, :, 0], expected, rtol=2 * (steps + 1) * EPS)


def test_the_table_of_textbook_methods_is_complete() -> None:
    assert set(ALL) == set(INTEGRATORS) | {"umbra", "umbra-repaired"} == set(ONE_STEP)
