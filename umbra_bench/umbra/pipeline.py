"""The four stages of ``PhysicsService::Step()``, as the devlog publishes them.

Each stage is a pure function of arrays of shape (3, N), rows x, y, angle: linear and angular motion
are one formula. NumPy and JAX arrays are both welcome, so that a game's frame and a compiled study
run the same physics.

Source: the devlog, "Putting It All Together: The Integration Pipeline".
"""

from __future__ import annotations

import math

from umbra_bench.umbra.bodies import Array, Bodies, UmbraState

TWO_PI = 2.0 * math.pi


def gravity_force(gravity: Array, inverse_mass: Array, affected: Array) -> Array:
    """Gravity as a force, N: F = g / (1/m) where the flag is set and the mass finite, else 0.

    Args:
        gravity: shape (2,), m/s^2.
        inverse_mass: shape (3, N), 1/kg and 1/(kg m^2).
        affected: shape (N,), the flag of each body.

    Returns:
        Shape (3, N): Fx, Fy and no torque.
    """
    xp = inverse_mass.__array_namespace__()
    pulled = affected & (inverse_mass[0] > 0.0)
    mass = xp.where(pulled, 1.0 / xp.where(pulled, inverse_mass[0], 1.0), 0.0)
    return xp.stack([gravity[0] * mass, gravity[1] * mass, xp.zeros_like(mass)])


def integrate_forces(
    velocity: Array, acceleration: Array, force: Array, inverse_mass: Array, dt: Array
) -> tuple[Array, Array]:
    """Phase 1, forces become velocities: v += (a_old + a_new)/2 dt, with a_new = F/m.

    Returns:
        The new velocity and the new acceleration, to be stored for the next frame.
    """
    new_acceleration = force * inverse_mass
    velocity = velocity + (acceleration + new_acceleration) * 0.5 * dt
    return velocity, new_acceleration


def integrate_velocities(position: Array, velocity: Array, acceleration: Array, dt: Array) -> Array:
    """Phase 2, velocities become positions: x += v dt + a dt^2/2; angles end in [0, 2 pi)."""
    # The displacement is summed before it is added, as C++ does with +=: in float32 the second term
    # is often less than the last digit of the position.
    displacement = velocity * dt + acceleration * (dt * dt * 0.5)
    return wrap_angle(position + displacement)


def apply_damping(velocity: Array, damping: Array | None, dt: Array) -> Array:
    """Phase 3, exponential damping: v *= d^dt, with d the fraction kept per second; None keeps all."""
    return velocity if damping is None else velocity * damping**dt


def clear_accumulators(force: Array) -> Array:
    """Phase 4: forces last one frame."""
    return force.__array_namespace__().zeros_like(force)


def step(bodies: Bodies, state: UmbraState, dt: Array) -> UmbraState:
    """One frame, as published: the four stages in their order.

    Args:
        bodies: the constants of the bodies.
        state: with the forces of this frame in its accumulators.
        dt: the step, s, of the precision of the state.
    """
    position, velocity, acceleration, force = state
    velocity, acceleration = integrate_forces(
        velocity, acceleration, force, bodies.inverse_mass, dt
    )
    position = integrate_velocities(position, velocity, acceleration, dt)
    velocity = apply_damping(velocity, bodies.damping, dt)
    force = clear_accumulators(force)
    # Stages 5 to 11, collision and solving, would go here.
    return UmbraState(position, velocity, acceleration, force)


def wrap_angle(position: Array) -> Array:
    """Return `position` with its row of angles brought to [0, 2 pi)."""
    xp = position.__array_namespace__()
    angle = position[2]
    angle = angle - TWO_PI * xp.floor(angle / TWO_PI)
    # An angle just below zero rounds to 2 pi itself, and one just below 2 pi may round below zero.
    angle = xp.where((angle >= TWO_PI) | (angle < 0.0), 0.0, angle)
    return xp.stack([position[0], position[1], angle])
