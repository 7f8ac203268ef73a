"""PhysX 5 (sapien), forces added before each step of the CPU system.

State precision: float32.

======================  ==========================================================================
switched off            why
======================  ==========================================================================
gravity                 disabled for every body: it is one of the harness's force laws
linear, angular damping 0 (angular by default 0.05): the harness damps all engines alike
speed limits            raised to 1e10 (angular by default 100 rad/s)
sleeping                threshold 0 (by default 0.005)
collisions              no body has a shape; mass and inertia are set as numbers
======================  ==========================================================================

Held to the plane by locking motion along z and turns about x and y. Static bodies have no
counterpart: nothing touches them. A kinematic body has none either: a skip.
"""

from __future__ import annotations

import math

import numpy as np

from umbra_bench.engines.quiet import quietly
from umbra_bench.engines.spatial import SpatialBodies
from umbra_bench.scenario import Scenario
from umbra_bench.system import compiled_force

with quietly():
    import sapien
    from sapien import physx

_OUT_OF_PLANE = [False, False, True, True, True, False]
_UNLIMITED = 1e10


class PhysXWorld:
    """A PhysX scene with the bodies of a scenario."""

    damps_itself = False

    def __init__(self, scenario: Scenario) -> None:
        bodies = SpatialBodies("physx", scenario)
        self._force = compiled_force(scenario)
        self._system = physx.PhysxCpuSystem()
        self._scene = sapien.Scene([self._system])
        self._dt = 0.0
        self._dynamic = []
        for i, definition in bodies.dynamic:
            body = physx.PhysxRigidDynamicComponent()
            body.mass = definition.mass
            body.inertia = [definition.moment_of_inertia] * 3
            body.linear_damping = body.angular_damping = 0.0
            body.sleep_threshold = 0.0
            body.max_linear_velocity = body.max_angular_velocity = _UNLIMITED
            body.disable_gravity = True
            entity = sapien.Entity()
            entity.add_component(body)
            half = definition.angle / 2
            entity.pose = sapien.Pose(
                [*definition.position, 0.0], [math.cos(half), 0.0, 0.0, math.sin(half)]
            )
            self._scene.add_entity(entity)
            body.set_locked_motion_axes(_OUT_OF_PLANE)
            body.linear_velocity = [*definition.velocity, 0.0]
            body.angular_velocity = [0.0, 0.0, definition.angular_velocity]
            self._dynamic.append((i, body, entity))

    def step(self, dt: float, position: np.ndarray, velocity: np.ndarray) -> None:
        if dt != self._dt:
            self._system.set_timestep(dt)
            self._dt = dt
        fx, fy, torque = self._force(position, velocity).tolist()
        for i, body, _ in self._dynamic:
            body.add_force_torque([fx[i], fy[i], 0.0], [0.0, 0.0, torque[i]])
        self._system.step()

    def read(self, position: np.ndarray, velocity: np.ndarray) -> None:
        for i, body, entity in self._dynamic:
            pose = entity.pose
            place, turn = pose.p, pose.q
            position[0, i], position[1, i] = place[0], place[1]
            position[2, i] = 2.0 * math.atan2(turn[3], turn[0])
            speed = body.linear_velocity
            velocity[0, i], velocity[1, i] = speed[0], speed[1]
            velocity[2, i] = body.angular_velocity[2]

    def set_velocity(self, velocity: np.ndarray) -> None:
        for i, body, _ in self._dynamic:
            vx, vy, omega = velocity[:, i].tolist()
            body.linear_velocity = [vx, vy, 0.0]
            body.angular_velocity = [0.0, 0.0, omega]
