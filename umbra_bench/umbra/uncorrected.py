"""The published pipeline without its a dt^2/2, to see what that term does: not a method to use."""

from __future__ import annotations

from umbra_bench.umbra.bodies import Array, Bodies, UmbraState
from umbra_bench.umbra.pipeline import (
    apply_damping,
    clear_accumulators,
    integrate_forces,
    integrate_velocities,
)


def uncorrected_step(bodies: Bodies, state: UmbraState, dt: Array) -> UmbraState:
    """One frame as published, but for x += v dt alone."""
    position, velocity, acceleration, force = state
    velocity, acceleration = integrate_forces(
        velocity, acceleration, force, bodies.inverse_mass, dt
    )
    position = integrate_velocities(position, velocity, 0.0 * acceleration, dt)
    velocity = apply_damping(velocity, bodies.damping, dt)
    return UmbraState(position, velocity, acceleration, clear_accumulators(force))
