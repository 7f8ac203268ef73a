"""UMBRA through the door that a game uses, so that every call of that door is measured.

State precision: float32. The bodies are created at rest and set in motion by impulses, some of them
off-centre; the force of each frame is applied in three parts, at the centre, off-centre and as a
torque, that add up to the force law's. What the stages make of it must be what `umbra` makes of it.

Nothing is switched off: gravity and damping are the service's own.
"""

from __future__ import annotations

import numpy as np

from umbra_bench.scenario import Scenario
from umbra_bench.system import body_definition, compiled_force
from umbra_bench.umbra.bodies import BodyDefinition
from umbra_bench.umbra.service import PhysicsService

_LEVER = np.array([0.3, -0.2])
"""Where, seen from the centre, half of each force is applied, m."""


class UmbraService:
    """A :class:`PhysicsService` with the bodies of a scenario."""

    damps_itself = True

    def __init__(self, scenario: Scenario) -> None:
        self._service = PhysicsService(gravity=scenario.gravity)
        # The service has its own gravity: the laws supply all other forces.
        self._force = compiled_force(scenario.model_copy(update={"gravity": (0.0, 0.0)}))
        self._moved: list[int] = []
        for body in scenario.bodies:
            definition = body_definition(body, scenario)
            if definition.inverse_masses[0] == 0.0:
                self._service.create_body(definition)
                continue
            at_rest = body.model_copy(update={"velocity": (0.0, 0.0), "angular_velocity": 0.0})
            handle = self._service.create_body(body_definition(at_rest, scenario))
            self._moved.append(handle)
            self._set_in_motion(handle, definition)

    def _set_in_motion(self, handle: int, moving: BodyDefinition) -> None:
        """Give a body its velocity by an impulse and its spin by a couple of two."""
        (vx, vy), (x, y) = moving.velocity, moving.position
        self._service.apply_impulse(handle, (moving.mass * vx, moving.mass * vy))
        half = moving.moment_of_inertia * moving.angular_velocity / 2
        self._service.apply_impulse_at_point(handle, (0.0, half), (x + 1.0, y))
        self._service.apply_impulse_at_point(handle, (0.0, -half), (x - 1.0, y))

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        force = self._force(position, velocity)
        for handle in self._moved:
            half = force[:2, handle] / 2
            point = position[:2, handle] + _LEVER
            moment = _LEVER[0] * half[1] - _LEVER[1] * half[0]
            self._service.apply_force(handle, tuple(half))
            self._service.apply_force_at_point(handle, tuple(half), tuple(point))
            self._service.apply_torque(handle, force[2, handle] - moment)
        self._service.step(dt)

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        for handle in range(len(self._service)):
            place, angle, speed, spin = self._service.read(handle)
            position[:, handle] = (*place, angle)
            velocity[:, handle] = (*speed, spin)

    def set_velocity(self, velocity: np.ndarray) -> None:
        raise AssertionError("the service damps itself")
