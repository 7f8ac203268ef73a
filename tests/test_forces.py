"""Force laws: gradients of potentials, Newton's third law, torques, and who feels them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from problems import EPS, problem

from umbra_bench.forces import Acting, angle_difference
from umbra_bench.jax_settings import float64_allowed
from umbra_bench.scenario import FORCE_KINDS, Scenario
from umbra_bench.system import System, build_system

# One scenario for each law ------------------------------------------------------------------------

BODIES = (
    {"mass": 2.0, "position": [0.5, 0.2], "inertia": 0.7},
    {"mass": 0.5, "position": [-0.6, 1.0], "affected_by_gravity": False},
    {"mass": 1.3, "position": [1.5, -1.0]},
)


def with_forces(*forces: dict[str, Any], **more: Any) -> Scenario:
    return problem(*BODIES, forces=list(forces), **more)


def on(body: int, kind: str, **parameters: Any) -> dict[str, Any]:
    return {"kind": kind, "body": f"body_{body}", **parameters}


def between(body: int, other: int, **parameters: Any) -> dict[str, Any]:
    return on(body, "spring", other=f"body_{other}", **parameters)


MUTUAL = {"kind": "mutual_gravity", "bodies": ["body_0", "body_1", "body_2"]}

CONSERVATIVE = {
    "uniform gravity": with_forces(gravity=[0.4, -9.81]),
    "spring": with_forces(on(0, "spring", anchor=[0.1, -0.2], stiffness=8.0)),
    "springs with rest lengths": with_forces(
        on(0, "spring", anchor=[0.1, -0.2], stiffness=8.0, rest_length=0.9),
        on(2, "spring", anchor=[1.0, 1.0], stiffness=3.0, rest_length=1.7),
        on(0, "spring", anchor=[-2.0, 0.0], stiffness=1.5),
    ),
    "spring with a point": with_forces(
        on(1, "spring", anchor=[0.1, -0.2], stiffness=8.0, rest_length=0.5, point=[0.4, -0.3])
    ),
    "springs between bodies": with_forces(
        between(0, 1, stiffness=5.0, rest_length=0.6), between(2, 1, stiffness=2.0)
    ),
    "spring between bodies with a point": with_forces(
        between(0, 2, stiffness=5.0, rest_length=0.6, point=[0.2, 0.5]),
        between(2, 1, stiffness=2.0, point=[-0.3, 0.1]),
    ),
    "torsion springs": with_forces(
        on(0, "torsion_spring", stiffness=1.7, rest_angle=0.2),
        on(2, "torsion_spring", stiffness=0.4, rest_angle=-2.9),
    ),
    "central gravity": with_forces(
        on(0, "central_gravity", mu=1.4, centre=[-0.2, 0.3]), on(2, "central_gravity", mu=0.6)
    ),
    "mutual gravity": with_forces(MUTUAL | {"gravitational_constant": 1.2}),
    "world force": with_forces(on(2, "constant_force", force=[1.5, -0.4])),
    "world forces with points": with_forces(
        on(0, "constant_force", force=[1.5, -0.4], point=[0.3, 0.2]),
        on(2, "constant_force", force=[-0.6, 0.8], point=[-0.1, 0.7]),
    ),
}

NOT_CONSERVATIVE = {
    "spring with a dashpot": with_forces(
        on(0, "spring", anchor=[0.1, -0.2], stiffness=8.0, rest_length=0.9, damping=0.7,
           point=[0.4, -0.3])
    ),
    "dashpot between bodies": with_forces(
        between(0, 1, stiffness=5.0, damping=0.7, point=[0.2, 0.1])
    ),
    "torsion spring with a damper": with_forces(
        on(1, "torsion_spring", stiffness=1.7, damping=0.3)
    ),
    "thruster": with_forces(
        on(1, "constant_force", force=[1.5, -0.4], point=[0.3, 0.2], frame="body")
    ),
    "constant torque": with_forces(on(1, "constant_torque", torque=0.9)),
    "drag": with_forces(on(1, "drag", coefficient=0.6), on(2, "drag", coefficient=0.2)),
}  # fmt: skip

LAWS = CONSERVATIVE | NOT_CONSERVATIVE

number = st.floats(-3.0, 3.0)
rows = arrays(np.float64, (3, len(BODIES)), elements=number)


def apart(position: np.ndarray) -> bool:
    """No body near another or near a centre of gravity, where round-off has no bound."""
    places = [*position[:2].T, np.array([-0.2, 0.3]), np.zeros(2)]
    gaps = [np.hypot(*(a - b)) for i, a in enumerate(places) for b in places[:i]]
    return min(gaps) > 0.1


def untwisted(position: np.ndarray) -> bool:
    """No torsion spring near half a turn, where its potential has a corner."""
    twists = [angle_difference(position[2], rest) for rest in (0.2, -2.9)]
    return bool(np.abs(twists).max() < 3.1)


@jax.jit
def _measure(system: System, position: Any, velocity: Any) -> tuple[Any, Any, Any]:
    energy, gradient = jax.value_and_grad(system.potential_energy)(position)
    return system.force(position, velocity), energy, gradient


def measured_by_jax(
    system: System, position: np.ndarray, velocity: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Force, potential energy and its gradient, from code that is compiled once for each law."""
    with float64_allowed():
        force, energy, gradient = _measure(system, position, velocity)
        return np.asarray(force), np.asarray(energy), np.asarray(gradient)


# Terms are at most a few thousand (1/d^2 at d = 0.1, times masses and constants), a few tens of
# roundings each; relative to the largest force with a floor of order 1 for those that cancel.
ROUNDINGS = 64 * EPS


def size(*forces: np.ndarray) -> float:
    return max(10.0, *(float(np.abs(force).max()) for force in forces))


@pytest.mark.parametrize("law", CONSERVATIVE)
def test_a_conservative_force_is_minus_the_gradient_of_its_potential(law: str) -> None:
    system = build_system(CONSERVATIVE[law])
    assert system.conservative

    @settings(max_examples=25)
    @given(rows, rows)
    def check(position: np.ndarray, velocity: np.ndarray) -> None:
        assume(apart(position) and untwisted(position))
        force = system.force(position, velocity)
        _, _, gradient = measured_by_jax(system, position, velocity)
        np.testing.assert_allclose(force, -gradient, rtol=0, atol=ROUNDINGS * size(force))

    check()


@pytest.mark.parametrize("law", NOT_CONSERVATIVE)
def test_forces_that_do_other_work_say_so(law: str) -> None:
    assert not build_system(NOT_CONSERVATIVE[law]).conservative


@pytest.mark.parametrize("law", LAWS)
def test_numpy_and_jax_evaluate_the_same_law(law: str) -> None:
    system = build_system(LAWS[law])

    @settings(max_examples=25)
    @given(rows, rows)
    def check(position: np.ndarray, velocity: np.ndarray) -> None:
        assume(apart(position))
        force, energy = system.force(position, velocity), system.potential_energy(position)
        compiled, compiled_energy, _ = measured_by_jax(system, position, velocity)
        np.testing.assert_allclose(compiled, force, rtol=0, atol=ROUNDINGS * size(force))
        assert compiled_energy == pytest.approx(
            float(energy), rel=0, abs=ROUNDINGS * max(100.0, abs(energy))
        )

    check()


@pytest.mark.parametrize("law", LAWS)
def test_a_law_keeps_the_precision_of_its_state(law: str) -> None:
    system = build_system(LAWS[law], "float32")
    position = np.array([[0.5, -0.6, 1.5], [0.2, 1.0, -1.0], [0.3, 0.1, 2.0]], np.float32)
    with float64_allowed():
        for compiled in jax.eval_shape(_measure, system, position, position):
            assert compiled.dtype == np.float32
    assert system.force(position, position).dtype == np.float32
    assert system.potential_energy(position).dtype == np.float32


def test_every_kind_of_force_is_tested() -> None:
    kinds = {force.kind for scenario in LAWS.values() for force in scenario.forces}
    assert kinds == set(FORCE_KINDS)


# Newton's third law -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "law",
    [
        "springs between bodies",
        "spring between bodies with a point",
        "dashpot between bodies",
        "mutual gravity",
    ],
)
def test_action_is_reaction(law: str) -> None:
    system = build_system(LAWS[law])

    @settings(max_examples=25)
    @given(rows, rows)
    def check(position: np.ndarray, velocity: np.ndarray) -> None:
        assume(apart(position))
        fx, fy, torque = force = system.force(position, velocity)
        moment = (position[0] * fy - position[1] * fx + torque).sum()
        assert abs(fx.sum()) <= ROUNDINGS * size(force)
        assert abs(fy.sum()) <= ROUNDINGS * size(force)
        assert abs(moment) <= ROUNDINGS * size(force) * 10  # arms are up to 6 m

    check()


# Torque = r x F -----------------------------------------------------------------------------------


@given(rows, rows)
def test_a_force_held_at_a_point_turns_by_r_cross_f(
    position: np.ndarray, velocity: np.ndarray
) -> None:
    point = [0.4, -0.3]
    laws = {
        "spring": on(1, "spring", anchor=[0.1, -0.2], stiffness=8.0, damping=0.5, point=point),
        "world": on(1, "constant_force", force=[1.5, -0.4], point=point),
        "body": on(1, "constant_force", force=[1.5, -0.4], point=point, frame="body"),
    }
    c, s = np.cos(position[2, 1]), np.sin(position[2, 1])
    rx, ry = np.array([[c, -s], [s, c]]) @ point
    for law in laws.values():
        force = build_system(with_forces(law)).force(position, velocity)
        fx, fy, torque = force[:, 1]
        assert torque == pytest.approx(rx * fy - ry * fx, rel=0, abs=ROUNDINGS * size(force))
        assert np.all(force[:, [0, 2]] == 0.0)


def test_a_thruster_turns_with_its_body_and_a_wind_does_not() -> None:
    position = np.zeros((3, 3))
    position[2] = np.pi / 2
    for frame, expected in (("body", (-0.25, 1.0)), ("world", (1.0, 0.25))):
        push = on(0, "constant_force", force=[1.0, 0.25], frame=frame)
        force = build_system(with_forces(push)).force(position, position)
        np.testing.assert_allclose(force[:2, 0], expected, rtol=0, atol=4 * EPS)


# Directions and signs, by hand --------------------------------------------------------------------


def at(*places: tuple[float, float, float]) -> np.ndarray:
    """Positions of the first bodies; the others far away."""
    rest = [(50.0, 60.0, 0.0), (-70.0, 80.0, 0.0)]
    return np.array([*places, *rest][:3]).T


STILL = np.zeros((3, 3))


@pytest.mark.parametrize(
    ("force", "position", "velocity", "expected"),
    [
        # k (l - l0) = 4 (5 - 3) = 8 N towards the anchor, along (3, 4)/5
        (on(0, "spring", anchor=[0.0, 0.0], stiffness=4.0, rest_length=3.0),
         (3.0, 4.0, 0.0), (0.0, 0.0, 0.0), (-4.8, -6.4, 0.0)),
        # the dashpot feels the part of the velocity along the spring: 5 m/s times 2 N s/m
        (on(0, "spring", anchor=[0.0, 0.0], stiffness=0.0, damping=2.0),
         (3.0, 4.0, 0.0), (3.0 - 4.0, 4.0 + 3.0, 0.0), (-6.0, -8.0, 0.0)),
        (on(0, "torsion_spring", stiffness=2.0, rest_angle=0.5, damping=0.5),
         (0.0, 0.0, 1.5), (0.0, 0.0, 3.0), (0.0, 0.0, -3.5)),
        # mu m / r^2 = 5 x 2 / 25, towards the centre
        (on(0, "central_gravity", centre=[0.0, 0.0], mu=5.0),
         (3.0, 4.0, 0.0), (0.0, 0.0, 0.0), (-0.24, -0.32, 0.0)),
        (on(0, "constant_torque", torque=0.75),
         (3.0, 4.0, 1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.75)),
        (on(0, "drag", coefficient=0.5),
         (3.0, 4.0, 1.0), (2.0, -6.0, 5.0), (-1.0, 3.0, 0.0)),
    ],
    ids=["spring", "dashpot", "torsion spring", "central gravity", "torque", "drag"],
)  # fmt: skip
def test_forces_by_hand(
    force: dict[str, Any],
    position: tuple[float, float, float],
    velocity: tuple[float, float, float],
    expected: tuple[float, float, float],
) -> None:
    found = build_system(with_forces(force)).force(at(position), at(velocity))[:, 0]
    np.testing.assert_allclose(found, expected, rtol=0, atol=16 * EPS * 10)


def test_mutual_gravity_by_hand() -> None:
    pair = MUTUAL | {"bodies": ["body_0", "body_1"], "gravitational_constant": 50.0}
    force = build_system(with_forces(pair)).force(at((0.0, 0.0, 0.0), (3.0, 4.0, 0.0)), STILL)
    # G m1 m2 / r^2 = 50 x 2 x 0.5 / 25 = 2 N
    np.testing.assert_allclose(force[:, 0], (1.2, 1.6, 0.0), rtol=0, atol=16 * EPS)
    np.testing.assert_allclose(force[:, 1], (-1.2, -1.6, 0.0), rtol=0, atol=16 * EPS)


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 2])
def test_a_torsion_spring_counts_no_turns(turns: int) -> None:
    system = build_system(with_forces(on(0, "torsion_spring", stiffness=2.0, rest_angle=0.2)))
    angle = 0.9 + 2 * np.pi * turns
    torque = system.force(at((0.0, 0.0, angle)), STILL)[2, 0]
    # A difference of angles up to 20 rad rounds a few times.
    assert torque == pytest.approx(-2.0 * 0.7, rel=0, abs=4 * 20 * EPS)


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_angles_differ_by_at_most_half_a_turn(angle: float, other: float) -> None:
    difference = float(angle_difference(np.array([angle]), np.array([other]))[0])
    # Half a turn of either sign is one place; rounding of 100 rad may cross it.
    assert abs(difference) <= np.pi + 100 * EPS
    assert np.cos(difference) == pytest.approx(np.cos(angle - other), rel=0, abs=200 * EPS)
    assert np.sin(difference) == pytest.approx(np.sin(angle - other), rel=0, abs=200 * EPS)


def test_half_a_turn_counts_as_positive() -> None:
    difference = angle_difference(np.array([np.pi, -np.pi]), np.zeros(2))
    np.testing.assert_array_equal(difference, [np.pi, np.pi])


# A spring without a length ------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 0.7])
@pytest.mark.parametrize("law", [
    lambda **more: on(0, "spring", anchor=[0.5, 0.2], **more),
    lambda **more: between(0, 1, **more),
], ids=["to an anchor", "between bodies"])  # fmt: skip
def test_a_spring_of_no_length_has_no_direction_and_exerts_nothing(
    law: Callable[..., dict[str, Any]], damping: float
) -> None:
    system = build_system(with_forces(law(stiffness=8.0, rest_length=1.0, damping=damping)))
    position = at((0.5, 0.2, 0.0), (0.5, 0.2, 0.0))
    velocity = at((1.0, 2.0, 0.0))
    compiled, _, gradient = measured_by_jax(system, position, velocity)
    np.testing.assert_array_equal(system.force(position, velocity), STILL)
    np.testing.assert_array_equal(compiled, STILL)
    np.testing.assert_array_equal(gradient, STILL)
    assert system.potential_energy(position) == pytest.approx(8.0 / 2, rel=4 * EPS)


# Who feels a force --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind", [{"kind": "static"}, {"kind": "kinematic"}, {"mass": 0.0}], ids=str
)
def test_bodies_of_infinite_mass_feel_nothing_and_others_feel_them(kind: dict[str, Any]) -> None:
    wall = {"mass": 3.0, "position": [1.0, 0.0]} | kind
    bob = {"mass": 2.0, "position": [0.0, 1.0]}
    scenario = problem(
        wall,
        bob,
        forces=[
            between(1, 0, stiffness=5.0, point=[0.1, 0.0]),
            between(0, 1, stiffness=5.0, point=[0.1, 0.0]),
            on(0, "spring", anchor=[9.0, 9.0], stiffness=4.0, damping=1.0),
            on(0, "constant_torque", torque=2.0),
            on(0, "constant_force", force=[1.0, 1.0], point=[0.3, 0.0]),
            on(0, "drag", coefficient=2.0),
        ],
        gravity=[1.0, -9.81],
    )
    system = build_system(scenario)
    position, velocity = np.array([[1.0, 0.0], [0.0, 1.0], [0.2, 0.3]]), np.ones((3, 2))
    acceleration = system.acceleration(position, velocity)
    assert np.all(acceleration[:, 0] == 0.0)
    assert np.all(acceleration[:, 1] != 0.0)


@pytest.mark.parametrize("kind", ["static", "kinematic"])
def test_a_static_mass_attracts_and_does_not_move(kind: str) -> None:
    sun, planet = {"mass": 4.0, "kind": kind}, {"mass": 2.0, "position": [2.0, 0.0]}
    pair = {"kind": "mutual_gravity", "bodies": ["body_0", "body_1"], "gravitational_constant": 1.0}
    position = np.array([[0.0, 2.0], [0.0, 0.0], [0.0, 0.0]])
    system = build_system(problem(sun, planet, forces=[pair]))
    acceleration = system.acceleration(position, np.zeros((3, 2)))
    np.testing.assert_allclose(acceleration, [[0, -1], [0, 0], [0, 0]], rtol=0, atol=4 * EPS)


def test_a_body_of_no_inertia_feels_no_torque() -> None:
    bead = {"mass": 2.0, "inertia": 0.0}
    system = build_system(problem(bead, forces=[on(0, "constant_torque", torque=2.0)]))
    assert np.all(system.acceleration(np.zeros((3, 1)), np.zeros((3, 1))) == 0.0)


# Who feels which row ------------------------------------------------------------------------------


@given(st.data(), st.integers(1, 6))
def test_rows_are_summed_onto_their_bodies(data: st.DataObject, count: int) -> None:
    bodies = data.draw(st.lists(st.integers(0, count - 1), min_size=1, max_size=12))
    forces = data.draw(
        arrays(np.float64, (3, len(bodies)), elements=st.integers(-1000, 1000).map(float))
    )
    naive = np.zeros((3, count))
    for body, force in zip(bodies, forces.T, strict=True):
        naive[:, body] += force
    acting = Acting(tuple(bodies), count)
    np.testing.assert_array_equal(acting.collect(forces), naive)  # whole numbers: no rounding
    np.testing.assert_array_equal(acting.take(naive), naive[:, bodies])
