"""The published stages put right: second order, with not a line of any stage changed.

Two changes, and both are needed (the devlog's formulas are velocity Verlet; its order is not):

1. the phases are swapped: positions first, from the stored acceleration; then the forces at the new
   positions; then velocities, with the average that now spans the step that was taken;
2. the stored acceleration is primed with a(x_0), instead of zero, before the first frame.
"""

from __future__ import annotations

from collections.abc import Callable

from umbra_bench.umbra.bodies import Array, Bodies, UmbraState
from umbra_bench.umbra.pipeline import (
    apply_damping,
    clear_accumulators,
    integrate_forces,
    integrate_velocities,
)

ForceLaw = Callable[[Array, Array], Array]
"""The force on every body, shape (3, N), from positions and velocities, shape (3, N) each."""


def primed(bodies: Bodies, state: UmbraState, force: ForceLaw) -> UmbraState:
    """Store the acceleration of the initial state, as the first frame needs it."""
    acceleration = force(state.position, state.velocity) * bodies.inverse_mass
    return state._replace(acceleration=acceleration)


def repaired_step(bodies: Bodies, state: UmbraState, dt: Array, force: ForceLaw) -> UmbraState:
    """One frame with the phases swapped; the game applies its forces between the two."""
    position, velocity, acceleration, accumulated = state
    position = integrate_velocities(position, velocity, acceleration, dt)
    accumulated = accumulated + force(position, velocity)
    velocity, acceleration = integrate_forces(
        velocity, acceleration, accumulated, bodies.inverse_mass, dt
    )
    velocity = apply_damping(velocity, bodies.damping, dt)
    accumulated = clear_accumulators(accumulated)
    return UmbraState(position, velocity, acceleration, accumulated)
