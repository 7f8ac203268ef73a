"""Bullet (pybullet), driven as its guide teaches: external forces, then `stepSimulation`.

State precision: float64 (the wheel is built in double precision).

======================  ==========================================================================
switched off            why
======================  ==========================================================================
gravity                 0: gravity is one of the harness's force laws
linear, angular damping 0 (by default 0.04): the harness damps all engines alike, after each step
speed limit             raised to 1e10 (by default 100)
sleeping                Bullet's default here: never
collisions              no body has a shape; mass and inertia are set as numbers
======================  ==========================================================================

Held to the plane by never being pushed out of it: forces are along x and y, torques about z. Static
bodies have no counterpart: nothing touches them. A kinematic body has none either: a skip.
"""

from __future__ import annotations

import math

import numpy as np

from umbra_bench.engines.quiet import quietly
from umbra_bench.engines.spatial import SpatialBodies
from umbra_bench.scenario import Scenario
from umbra_bench.system import compiled_force

with quietly():
    import pybullet


class BulletWorld:
    """A Bullet world with the bodies of a scenario."""

    damps_itself = False

    def __init__(self, scenario: Scenario) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        bodies = SpatialBodies("bullet", scenario)
        self._force = compiled_force(scenario)
        pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=self._client)
        self._dt = 0.0
        self._dynamic = []
        for i, definition in bodies.dynamic:
            body = pybullet.createMultiBody(
                baseMass=definition.mass,
                basePosition=(*definition.position, 0.0),
                baseOrientation=_about_z(definition.angle),
                physicsClientId=self._client,
            )
            pybullet.changeDynamics(
                body,
                -1,
                linearDamping=0.0,
                angularDamping=0.0,
                maxJointVelocity=1e10,
                localInertiaDiagonal=[definition.moment_of_inertia] * 3,
                physicsClientId=self._client,
            )
            pybullet.resetBaseVelocity(
                body,
                (*definition.velocity, 0.0),
                (0.0, 0.0, definition.angular_velocity),
                physicsClientId=self._client,
            )
            self._dynamic.append((i, body))

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        if dt != self._dt:
            pybullet.setTimeStep(dt, physicsClientId=self._client)
            self._dt = dt
        fx, fy, torque = self._force(position, velocity).tolist()
        for i, body in self._dynamic:
            pybullet.applyExternalForce(
                body,
                -1,
                (fx[i], fy[i], 0.0),
                (position[0, i], position[1, i], 0.0),
                pybullet.WORLD_FRAME,
                physicsClientId=self._client,
            )
            pybullet.applyExternalTorque(
                body, -1, (0.0, 0.0, torque[i]), pybullet.WORLD_FRAME, physicsClientId=self._client
            )
        pybullet.stepSimulation(physicsClientId=self._client)

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        for i, body in self._dynamic:
            place, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=self._client)
            speed, spin = pybullet.getBaseVelocity(body, physicsClientId=self._client)
            position[0, i], position[1, i] = place[0], place[1]
            position[2, i] = 2.0 * math.atan2(turn[2], turn[3])
            velocity[0, i], velocity[1, i], velocity[2, i] = speed[0], speed[1], spin[2]

    def set_velocity(self, velocity: np.ndarray) -> None:
        for i, body in self._dynamic:
            vx, vy, omega = velocity[:, i].tolist()
            pybullet.resetBaseVelocity(
                body, (vx, vy, 0.0), (0.0, 0.0, omega), physicsClientId=self._client
            )

    def __del__(self) -> None:
        pybullet.disconnect(self._client)


def _about_z(angle: float) -> tuple[float, float, float, float]:
    """The quaternion x, y, z, w of a turn about z."""
    return 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)
