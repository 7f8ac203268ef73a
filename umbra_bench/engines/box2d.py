"""Box2D (pybox2d 2.3.10), driven as its manual teaches: forces set, then `Step`.

State precision: float32.

======================  ==========================================================================
switched off            why
======================  ==========================================================================
gravity                 (0, 0): gravity is one of the harness's force laws
linear, angular damping 0: the harness damps all engines alike, after each step
sleeping                a sleeping body ignores its forces
collisions              no body has a fixture; mass and inertia are set as numbers
======================  ==========================================================================

What cannot be switched off: a body moves by at most 2 m and turns by at most a quarter turn in a step
(constants of the library).
"""

from __future__ import annotations

import numpy as np

from umbra_bench.engines.quiet import quietly
from umbra_bench.scenario import Scenario
from umbra_bench.system import body_definition, compiled_force

with quietly():
    import Box2D


class Box2DWorld:
    """A Box2D world with the bodies of a scenario."""

    damps_itself = False

    def __init__(self, scenario: Scenario) -> None:
        self._force = compiled_force(scenario)
        self._world = Box2D.b2World(gravity=(0.0, 0.0), doSleep=False)
        self._bodies = []
        self._dynamic = []
        for i, body in enumerate(scenario.bodies):
            definition = body_definition(body, scenario)
            place = {"position": definition.position, "angle": definition.angle}
            motion = {
                "linearVelocity": definition.velocity,
                "angularVelocity": definition.angular_velocity,
            }
            if definition.is_static:
                created = self._world.CreateStaticBody(**place)
            elif definition.kind == "kinematic":
                created = self._world.CreateKinematicBody(**place, **motion, allowSleep=False)
            else:
                created = self._world.CreateDynamicBody(**place, **motion, allowSleep=False)
                created.massData = Box2D.b2MassData(
                    mass=definition.mass, center=(0.0, 0.0), I=definition.moment_of_inertia
                )
                self._dynamic.append((i, created))
            self._bodies.append(created)

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        force = self._force(position, velocity).tolist()
        for i, body in self._dynamic:
            body.ApplyForceToCenter((force[0][i], force[1][i]), True)
            body.ApplyTorque(force[2][i], True)
        self._world.Step(dt, 1, 1)
        self._world.ClearForces()

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        for i, body in enumerate(self._bodies):
            position[0, i], position[1, i] = body.position
            position[2, i] = body.angle
            velocity[0, i], velocity[1, i] = body.linearVelocity
            velocity[2, i] = body.angularVelocity

    def set_velocity(self, velocity: np.ndarray) -> None:
        for i, body in self._dynamic:
            body.linearVelocity = float(velocity[0, i]), float(velocity[1, i])
            body.angularVelocity = float(velocity[2, i])
