"""A scenario as arrays: bodies and force laws of one precision, ready for any method."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import numpy as np

from umbra_bench.errors import UnsupportedScenario
from umbra_bench.forces import ForceLaw, build_laws
from umbra_bench.scenario import Body, Box, Circle, Scenario
from umbra_bench.state import State, kinetic_energy
from umbra_bench.umbra.bodies import Array, Bodies, BodyDefinition


class System(NamedTuple):
    """N bodies and the laws of the forces on them.

    Positions, velocities, forces and accelerations have shape (3, N), rows x, y, angle. A pytree:
    systems of one shape share compiled code, whatever their parameters.
    """

    bodies: Bodies
    laws: tuple[ForceLaw, ...]

    @property
    def velocity_dependent(self) -> bool:
        """Whether any force reads the velocity."""
        return any(law.velocity_dependent for law in self.laws)

    @property
    def conservative(self) -> bool:
        """Whether energy and nothing else follows from the forces: all have a potential, none damps."""
        return (
            all(law.conservative and not law.velocity_dependent for law in self.laws)
            and self.bodies.damping is None
        )

    def force(self, position: Array, velocity: Array) -> Array:
        """Force and torque on every body, N and N m."""
        if not self.laws:
            return position.__array_namespace__().zeros_like(position)
        return functools.reduce(operator.add, (law.force(position, velocity) for law in self.laws))

    def acceleration(self, position: Array, velocity: Array) -> Array:
        """a = F (1/m), m/s^2 and rad/s^2."""
        return self.force(position, velocity) * self.bodies.inverse_mass

    def potential_energy(self, position: Array) -> Array:
        """V, J, of the forces that have a potential."""
        if not self.laws:
            return position.__array_namespace__().zeros_like(position[0, 0])
        return _sum(_alike(law.potential(position) for law in self.laws))

    def energy(self, position: Array, velocity: Array) -> Array:
        """E = T + V, J."""
        potentials = (law.potential(position) for law in self.laws)
        return _sum(_alike([kinetic_energy(self.bodies, velocity), *potentials]))


def _alike(energies: Iterable[Array]) -> list[Array]:
    """Arrays of one shape added: a reduction costs a compiled loop more than the sums before it."""
    of_shape: dict[tuple[int, ...], Array] = {}
    for energy in energies:
        seen = of_shape.get(energy.shape)
        of_shape[energy.shape] = energy if seen is None else seen + energy
    return list(of_shape.values())


def _sum(energies: Iterable[Array]) -> Array:
    return functools.reduce(operator.add, (energy.sum() for energy in energies))


def build_system(scenario: Scenario, precision: str = "float64") -> System:
    """The bodies and force laws of a scenario, as NumPy arrays of `precision`.

    Raises:
        UnsupportedScenario: a number of a body or of a force overflows.
    """
    definitions = [body_definition(body, scenario) for body in scenario.bodies]
    _require_held(scenario, definitions, precision)
    bodies = Bodies.of(definitions, np.dtype(precision).type)
    with np.errstate(over="ignore"):
        laws = build_laws(scenario, bodies)
    for law in laws:
        if not all(np.isfinite(parameter).all() for parameter in jax.tree.leaves(law)):
            raise UnsupportedScenario(
                f"scenario {scenario.name}: a {type(law).__name__} has a number that {precision} does "
                "not hold"
            )
    return System(bodies, laws)


def _require_held(
    scenario: Scenario, definitions: Sequence[BodyDefinition], precision: str
) -> None:
    """Refuse a scenario whose bodies `precision` cannot hold.

    Raises:
        UnsupportedScenario: a mass, its inverse, a place or a velocity overflows.
    """
    largest = float(np.finfo(precision).max)
    for body, d in zip(scenario.bodies, definitions, strict=True):
        numbers = (d.mass, d.moment_of_inertia, *d.inverse_masses, *d.position, d.angle)
        if any(abs(number) > largest for number in (*numbers, *d.velocity, d.angular_velocity)):
            raise UnsupportedScenario(
                f"scenario {scenario.name}: body {body.name!r} has a mass, a place or a "
                f"velocity that {precision} does not hold"
            )


def initial_state(scenario: Scenario, precision: str = "float64") -> State:
    """The state in which a scenario starts, shape (3, N) each, as NumPy arrays of `precision`."""
    dtype = np.dtype(precision).type
    position = [(*body.position, body.angle) for body in scenario.bodies]
    velocity = [(*body.velocity, body.angular_velocity) for body in scenario.bodies]
    return State(np.array(position, dtype).T.copy(), np.array(velocity, dtype).T.copy())


def compiled_force(scenario: Scenario) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The force on every body as a compiled function of NumPy arrays, for engines that ask each step.

    Its caller holds :func:`umbra_bench.jax_settings.float64_allowed`, which costs more than the force.
    """
    return _compiled_force(scenario.model_dump_json())


@functools.lru_cache(maxsize=64)
def _compiled_force(document: str) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    # The parameters are constants of the compiled code: passing them costs more than using them.
    force = jax.jit(build_system(Scenario.model_validate_json(document)).force)
    return lambda position, velocity: np.asarray(force(position, velocity))


_STATED = (
    "mass",
    "inertia",
    "position",
    "angle",
    "velocity",
    "angular_velocity",
    "affected_by_gravity",
    "kind",
)
"""What a scenario file states of a body in the words of the engine."""


def body_definition(body: Body, scenario: Scenario) -> BodyDefinition:
    """A body of a scenario file as UMBRA defines bodies; its damping overrides the scenario's."""
    own = body.linear_damping, body.angular_damping
    shared = scenario.linear_damping, scenario.angular_damping
    linear, angular = (o if o is not None else s for o, s in zip(own, shared, strict=True))
    values = {key: getattr(body, key) for key in _STATED}
    match body.shape:
        case Box(width=width, height=height):
            values["box"] = (width, height)
        case Circle(radius=radius):
            values["disk_radius"] = radius
    return BodyDefinition(**values, linear_damping=linear, angular_damping=angular)
