"""pymunk (Chipmunk 2D), in the three ways in which its users apply forces.

State precision: float64. A step updates positions first and velocities second
(`cpSpaceStep`: position functions, then velocity functions), so that

- a force set before `step` acts on the velocity only after the position has moved: explicit Euler;
- a force evaluated inside the velocity callback, or by the engine's own springs, sees the new
  positions: symplectic Euler, positions first.

==================  ==============================================================================
switched off        why
==================  ==============================================================================
space.damping       1.0: the harness damps all engines alike, after each step
space.gravity       (0, 0): gravity is one of the harness's force laws (the engine's own in
                    `pymunk-spring`, where no force of the harness acts)
sleeping            pymunk's default: never
collisions          no body has a shape
==================  ==============================================================================
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymunk

from umbra_bench import scenario as problem
from umbra_bench.errors import UnsupportedScenario
from umbra_bench.scenario import Scenario
from umbra_bench.system import body_definition, compiled_force
from umbra_bench.umbra.bodies import BodyDefinition


class _Pymunk:
    """A pymunk space with the bodies of a scenario."""

    damps_itself = False

    def __init__(self, scenario: Scenario) -> None:
        self.force = compiled_force(scenario)
        self.space = pymunk.Space()
        self.space.gravity, self.space.damping = (0.0, 0.0), 1.0
        definitions = [body_definition(body, scenario) for body in scenario.bodies]
        self.bodies = [_create(definition) for definition in definitions]
        self.space.add(*self.bodies)
        self.dynamic = [
            (i, body) for i, body in enumerate(self.bodies) if body.body_type == pymunk.Body.DYNAMIC
        ]

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        self.space.step(dt)

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        for i, body in enumerate(self.bodies):
            position[0, i], position[1, i] = body.position
            position[2, i] = body.angle
            velocity[0, i], velocity[1, i] = body.velocity
            velocity[2, i] = body.angular_velocity

    def set_velocity(self, velocity: np.ndarray) -> None:
        for i, body in self.dynamic:
            body.velocity = float(velocity[0, i]), float(velocity[1, i])
            body.angular_velocity = float(velocity[2, i])


class ForceBeforeStep(_Pymunk):
    """`pymunk`: the force set before `step`, as the manual teaches."""

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        force = self.force(position, velocity)
        for i, body in self.dynamic:
            body.force = float(force[0, i]), float(force[1, i])
            body.torque = float(force[2, i])
        self.space.step(dt)


class ForceInCallback(_Pymunk):
    """`pymunk-velocity-func`: the force evaluated when the engine updates velocities."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        self._force: np.ndarray | None = None
        shape = (3, len(self.bodies))
        self._moved, self._unkicked = np.empty(shape), np.empty(shape)
        for i, body in self.dynamic:
            body.velocity_func = self._velocity_function(i)

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        self._force = None
        super().step(dt, position, velocity)

    def _velocity_function(self, i: int) -> Any:
        def update(body: pymunk.Body, gravity: Any, damping: float, dt: float) -> None:
            if self._force is None:  # the first body of this step: all have moved, none is kicked
                self.read(self._moved, self._unkicked)
                self._force = self.force(self._moved, self._unkicked)
            body.force = float(self._force[0, i]), float(self._force[1, i])
            body.torque = float(self._force[2, i])
            pymunk.Body.update_velocity(body, gravity, damping, dt)

        return update


class OwnSprings(_Pymunk):
    """`pymunk-spring`: springs, torsion springs and gravity are the engine's own."""

    def __init__(self, scenario: Scenario) -> None:
        super().__init__(scenario)
        if not scenario.forces:
            raise UnsupportedScenario("the scenario has no springs")
        self.space.gravity = scenario.gravity
        if any(scenario.gravity) and not all(b.affected_by_gravity for b in scenario.bodies):
            raise UnsupportedScenario("pymunk's gravity cannot spare a body")
        world = self.space.static_body
        by_name = {b.name: body for b, body in zip(scenario.bodies, self.bodies, strict=True)}
        for force in scenario.forces:
            match force:
                case problem.Spring():
                    body = by_name[force.body]
                    other = by_name[force.other] if force.other else world
                    end = force.anchor or (0.0, 0.0)
                    spring: pymunk.Constraint = pymunk.DampedSpring(
                        other,
                        body,
                        end,
                        force.point,
                        force.rest_length,
                        force.stiffness,
                        force.damping,
                    )
                case problem.TorsionSpring():
                    spring = pymunk.DampedRotarySpring(
                        world,
                        by_name[force.body],
                        -force.rest_angle,
                        force.stiffness,
                        force.damping,
                    )
                case _:
                    raise UnsupportedScenario(f"pymunk has no constraint for a {force.kind}")
            self.space.add(spring)


def _create(definition: BodyDefinition) -> pymunk.Body:
    inertia = definition.moment_of_inertia or math.inf
    if definition.is_static:
        body = pymunk.Body(body_type=pymunk.Body.STATIC)
    elif definition.kind == "kinematic":
        body = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
    else:
        body = pymunk.Body(definition.mass, inertia)
    body.position, body.angle = definition.position, definition.angle
    if not definition.is_static:
        body.velocity = definition.velocity
        body.angular_velocity = definition.angular_velocity
    return body
